"""The water of a real picture, by the red-channel prior."""

from uwaug.prior.entry import WaterEstimate, red_channel_prior

__all__ = ["WaterEstimate", "red_channel_prior"]
