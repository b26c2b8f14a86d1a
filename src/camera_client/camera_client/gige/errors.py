"""What a device's answer can be besides the one hoped for."""

from __future__ import annotations


class DeviceRefusal(Exception):
    """The device answered no: the feature is locked, absent, or does not take the value."""


class DeviceSilence(Exception):
    """The device did not answer in time: it is off, unplugged, or gone."""
