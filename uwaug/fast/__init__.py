"""The compiled twin of image formation: loops by numba, with the extra `fast`."""

from uwaug.fast.gate import can, load, warm_up

__all__ = ["can", "load", "warm_up"]
