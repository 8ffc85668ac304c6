"""Reading of bags (through rosbags): topics, and messages with their times."""

import importlib.util
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tactorch.errors import ConfigError, FileError
from tactorch.ros2.limits import limited

_log = logging.getLogger(__name__)
_SHOWN = 20  # topics that a message lists
_NS = 1e-9


@dataclass(eq=False)
class Bag:
    """An open bag.

    Attributes:
        path: The bag, for messages.
        topics: Type of the messages of each topic, such as "geometry_msgs/msg/PoseStamped".
        counts: Number of messages of each topic.
        begin_ns: Time of the first message, ns since 1970; times are relative to it.
    """

    path: Path
    topics: Mapping[str, str]
    counts: Mapping[str, int]
    begin_ns: int
    _reader: Any
    _unstamped: set[str] = field(default_factory=set)

    def choose(self, topic: str | None, types: Sequence[str], setting: str) -> str:
        """Return a topic of one of some types: the given one, or the only one with messages.

        Raises:
            FileError: There is no such topic, more than one, or it is of another type.
        """
        names = [t for t, kind in self.topics.items() if kind in types and self.counts[t]]
        if topic is None:
            if len(names) == 1:
                return names[0]
            found = f"several: {', '.join(sorted(names))}" if names else f"none; {self._listing()}"
            raise FileError(
                f"bag '{self.path}': {setting} is needed, as of topics of {' or '.join(types)} it "
                f"has {found}."
            )
        if topic not in self.topics:
            raise FileError(
                f"bag '{self.path}' has no topic {topic!r} ({setting}); {self._listing()}."
            )
        if self.topics[topic] not in types:
            raise FileError(
                f"bag '{self.path}': {setting}={topic} is of {self.topics[topic]}; give one of "
                f"{' or '.join(types)}."
            )
        if not self.counts[topic]:
            raise FileError(f"bag '{self.path}': {setting}={topic} has no message.")
        return topic

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield the messages of a topic in order, with the times they were received (ns).

        Raises:
            FileError: A message cannot be decoded, or the bag is damaged.
        """
        connections = [c for c in self._reader.connections if c.topic == topic]
        try:
            for connection, time_ns, raw in self._reader.messages(connections):
                yield time_ns, self._reader.deserialize(raw, connection.msgtype)
        except FileError:
            raise
        except Exception as error:  # errors of damaged bags have no common base
            raise FileError(
                f"bag '{self.path}': {topic} cannot be read ({_reason(error)}); the bag may be "
                "damaged. Repair it, as with ros2 bag reindex or mcap recover."
            ) from error

    def seconds(self, header: Any, received_ns: int, topic: str) -> float:
        """Return the time of a header since the begin of the bag, s.

        Where the header has no time, it is that at which the message was received.
        """
        stamp = header.stamp.sec * 1_000_000_000 + header.stamp.nanosec
        if not stamp:
            if topic not in self._unstamped:
                self._unstamped.add(topic)
                _log.warning(
                    "bag '%s': messages of %s have no time; the times at which they were received "
                    "are used.", self.path, topic,
                )  # fmt: skip
            stamp = received_ns
        return float((stamp - self.begin_ns) * _NS)

    def _listing(self) -> str:
        known = [f"{topic} ({kind})" for topic, kind in sorted(self.topics.items())]
        more = f" and {len(known) - _SHOWN} more" if len(known) > _SHOWN else ""
        return f"its topics are {', '.join(known[:_SHOWN]) or 'none'}{more}"


@contextmanager
def open_bag(path: str | Path) -> Iterator[Bag]:
    """Open a bag: a folder with metadata.yaml, or a file .mcap or .db3.

    Raises:
        ConfigError: rosbags is not installed.
        FileError: The bag is missing, damaged, or has no message.
    """
    if importlib.util.find_spec("rosbags") is None:
        raise ConfigError("Reading bags needs rosbags: pip install 'tactorch[ros]'.")
    source = Path(path)
    if not source.exists():
        raise FileError(f"bag not found: '{source}' is neither a folder nor a file.")
    if source.is_dir() and not (source / "metadata.yaml").is_file():
        raise FileError(
            f"'{source}' is no bag: it has no metadata.yaml. Give the folder that ros2 bag record "
            "wrote, or a file .mcap or .db3."
        )
    with limited(source):
        yield from _opened(source)


def _opened(source: Path) -> Iterator[Bag]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        # Bags of earlier versions do not store the definitions of their messages.
        reader = AnyReader([source], default_typestore=get_typestore(Stores.LATEST))
        reader.open()
        kinds = {name: info.msgtype or "several types" for name, info in reader.topics.items()}
        counts = {name: info.msgcount for name, info in reader.topics.items()}
        begin, total = reader.start_time, reader.message_count
    except FileError:
        raise
    except Exception as error:  # errors of damaged bags have no common base
        raise FileError(
            f"'{source}' cannot be read as a bag ({_reason(error)}). Is it complete? An unfinished "
            "one is repaired by ros2 bag reindex or mcap recover."
        ) from error
    try:
        if not total:
            raise FileError(f"bag '{source}' has no message; record it again.")
        yield Bag(source, kinds, counts, begin, reader)
    finally:
        reader.close()


def _reason(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
