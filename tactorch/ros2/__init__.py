"""Sessions recorded with ROS 2: bags (SQLite and MCAP), their transforms, wrenches and images."""

from tactorch.ros2.bag import Bag, open_bag
from tactorch.ros2.tracks import PoseTrack, WrenchTrack, read_poses, read_wrenches

__all__ = ["Bag", "PoseTrack", "WrenchTrack", "open_bag", "read_poses", "read_wrenches"]
