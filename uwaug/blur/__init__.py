"""Blur of a different width at every pixel: plan → stack of fixed blurs → weights."""

from uwaug.blur.plan import NO_BLUR, BlurPlan, plan_blur
from uwaug.blur.stack import varying_blur

__all__ = ["NO_BLUR", "BlurPlan", "plan_blur", "varying_blur"]
