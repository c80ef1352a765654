"""The compiled twin of image formation: loops by numba, with the extra `fast`."""

from uwaug.fast.gate import can, form, warm_up

__all__ = ["can", "form", "warm_up"]
