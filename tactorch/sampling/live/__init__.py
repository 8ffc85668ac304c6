"""Following a recording that grows: the map after each press, and where to press next."""

from tactorch.sampling.live.follow import Ended, Follower, FollowOptions, Seen, View
from tactorch.sampling.live.replay import replay
from tactorch.sampling.live.source import Arrival, Source
from tactorch.sampling.live.suggest import RULES, Suggester, Suggestion, SuggestOptions

__all__ = [
    "RULES",
    "Arrival",
    "Ended",
    "FollowOptions",
    "Follower",
    "Seen",
    "Source",
    "SuggestOptions",
    "Suggester",
    "Suggestion",
    "View",
    "replay",
]
