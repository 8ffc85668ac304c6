"""Following a recording that grows: the map after each press, and where to press next."""

from tactorch.live.follow import Ended, Follower, FollowOptions, Seen, View
from tactorch.live.replay import replay
from tactorch.live.source import Arrival, Source
from tactorch.live.suggest import RULES, Suggester, Suggestion, SuggestOptions

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
