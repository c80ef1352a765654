"""A blur of a different width at every pixel: demand → plan → stack of fixed blurs → weights."""

from uwaug.blur.demand import BlurDemand, blur_demand
from uwaug.blur.plan import NO_BLUR, BlurPlan, plan_blur
from uwaug.blur.stack import varying_blur

__all__ = ["NO_BLUR", "BlurDemand", "BlurPlan", "blur_demand", "plan_blur", "varying_blur"]
