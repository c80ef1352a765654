"""The compiled twin of image formation: loops by numba, with the extra `fast`."""

from uwaug.fast.gate import can, warm_up

__all__ = ["can", "warm_up"]
