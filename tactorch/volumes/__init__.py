"""Labelled volumes, such as segmentations of CT or MRI, and bodies meshed from them."""

from tactorch.volumes.body import Body
from tactorch.volumes.read import read_volume
from tactorch.volumes.select import BodySettings, read_body
from tactorch.volumes.volume import LabelVolume

__all__ = ["Body", "BodySettings", "LabelVolume", "read_body", "read_volume"]
