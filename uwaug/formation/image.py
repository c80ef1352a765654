"""Image formation: direct, forward-scattered and backscattered light.

    I = D + F + B                             z := m·z
    D = T_β(z)·J                              direct
    F = (T_G(z) − T_β(z))·blur_σ(z){J}        forward scatter
    B = V(0) − V(z)                           backscatter, the veil

The curves T_β, T_G and V and the width σ are the medium's, see `uwaug.optics.medium`. J is the
scene without water, z the distance along the ray [m], m the medium field, which multiplies it.

The blur is of J, weighted with the curves of the pixel that looks.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from uwaug import fast
from uwaug._support import checks
from uwaug.blur.plan import BlurPlan
from uwaug.blur.stack import blurred, mixed, node_weights
from uwaug.formation.colour import decoded, encoded, headroom
from uwaug.formation.demand import blur_demand, plan_for
from uwaug.formation.development import Development, Means, exposed
from uwaug.formation.inputs import effective_distance, validate
from uwaug.formation.setting import Setting
from uwaug.light import Light
from uwaug.light.snow import snowing
from uwaug.optics.curves import FARTHEST, Curves
from uwaug.optics.medium import Medium
from uwaug.optics.view import WIDE, View

# Pixels that are decoded, mixed and developed at a time, so that they stay in the caches. This
# halves the time at 1024 px; at 512 px it is the same.
_BAND_PIXELS = 1 << 18
_GREY = 0.25  # linear light that stands for a scene whose values are not looked at
_WALL_PX = (9, 12)  # height and width of a wall that stands for a scene under lamps

Blur = Callable[[Tensor, Tensor], Tensor]  # varying blur of light (Bx3xHxW) by widths (Bx1xHxW, px)


def form(
    image: Tensor,
    z: Tensor,
    setting: Setting,
    *,
    metres: Tensor | None = None,
    plan: BlurPlan | None = None,
    plans: Sequence[BlurPlan] = (),
    tolerance: float = 0.002,
    blur: Blur | None = None,
    normals: Tensor | None = None,
) -> Tensor:
    """D + F + B as the camera stores it. Nothing is checked.

    Args:
        image (Bx3xHxW tensor): uint8 or floating point, in the color space.
        z (Bx1xHxW tensor): effective distances, m, finite, ≥ 0; float32 or float64.
        setting: water, light and camera, of all pictures or of each.
        metres (Bx1xHxW): distances, m, for lamps, where a field multiplies them in z.
        plan: plan of the blur; None plans for the distances at hand.
        plans: one plan for each picture, in place of `plan`.
        tolerance: tolerance of a plan for the distances at hand.
        blur: function that blurs by the plan, in place of PyTorch.
        normals (Bx3xHxW): normals of the sensor's noise; None draws them.
    """
    if image.numel() == 0 or z.numel() == 0:
        return _nothing(image, z)
    if not plans and fast.can(image, z, setting):
        from uwaug.fast import render  # imports numba, which takes a second

        return render.form(image, z, setting, plan, tolerance, metres)
    size, color_space = (z.shape[-2], z.shape[-1]), setting.color_space
    medium, development = setting.medium.in_pixels(size, setting.view).to(z), setting.development
    J = _in_bands(medium, lambda x: decoded(x, color_space).to(z.dtype), image)
    T = setting.curves(medium, z, metres)
    gain = development.gain(J, z, medium, T)
    if plans:
        pictures = [slice(i, i + 1) for i in range(len(J))]
        pairs = zip(pictures, plans, strict=True)
        soft = torch.cat([blurred_as_seen(J[i], z[i], medium[i], plan) for i, plan in pairs])
    else:
        if plan is None:
            plan = _plan(z, medium, setting.light, gain, tolerance)
        soft = blurred_as_seen(J, z, medium, plan, blur)
    # after the gain: the camera is metered without snow, which changes nothing else in a picture
    T = snowing(T, medium, setting.light, z, setting.view, metres, J)
    largest = headroom(image) if color_space == "srgb" else 1.0
    sensor = development.noise
    if sensor is not None and normals is None:
        batch = max(len(J), len(z), len(medium), 0 if T is None else len(T.veil))
        normals = sensor.normals(batch, size, z)

    def stored(z: Tensor, J: Tensor, soft: Tensor, *noise: Tensor) -> Tensor:
        arriving = medium.image(z, J, soft, T)
        if sensor is not None:
            arriving = sensor.read(arriving, *noise)
        developed = development.shaped(exposed(arriving, gain))
        return encoded(developed, color_space, image.dtype, largest)

    shares = (z, J, soft) if normals is None else (z, J, soft, normals)
    return stored(*shares) if T is not None else _in_bands(medium, stored, *shares)


def _in_bands(medium: Medium, function: Callable[..., Tensor], *images: Tensor) -> Tensor:
    """Apply a function of single pixels to images, in bands of rows where nothing is learned."""
    if not checks.on_host(images[0]):
        return function(*images)
    if torch.is_grad_enabled() and (medium.requires_grad or checks.records(*images)):
        return function(*images)
    rows = max(1, _BAND_PIXELS // images[0].shape[-1])
    if rows >= images[0].shape[-2]:
        return function(*images)
    bands = zip(*(torch.split(image, rows, -2) for image in images), strict=True)
    return torch.cat([function(*band) for band in bands], -2)


def _nothing(image: Tensor, z: Tensor) -> Tensor:
    return image.expand(max(len(image), len(z)) if len(image) and len(z) else 0, -1, -1, -1)


def _plan(
    z: Tensor, medium: Medium, light: Light | None, gain: Tensor, tolerance: float
) -> BlurPlan:
    brightest = medium if light is None else light.planned(medium)
    size = z.shape[-2], z.shape[-1]
    return plan_for(z, brightest.brightened(gain.detach()), size, tolerance)


def blurred_as_seen(
    J: Tensor, z: Tensor, medium: Medium, plan: BlurPlan, blur: Blur | None = None
) -> Tensor:
    """J (Bx3xHxW) blurred by forward scatter, at each pixel by the width, px, at its distance z."""
    if plan.sigmas == (0.0,) and not medium.requires_grad:
        return J
    if blur is not None:
        return blur(J, medium.width(z))
    stack = blurred(J, plan)
    if len(stack) == 1:  # the width does nothing: its gradient is 0, not missing
        return stack[0] + 0 * medium.width(z) if medium.requires_grad else stack[0]

    def mixture(z: Tensor, *stack: Tensor) -> Tensor:
        return mixed(list(stack), node_weights(medium.width(z), plan))

    return _in_bands(medium, mixture, z, *stack)


def terms_of(
    J: Tensor,
    z: Tensor,
    setting: Setting,
    metres: Tensor | None = None,
    tolerance: float = 0.002,
) -> tuple[Curves, dict[str, Tensor], Tensor]:
    """Curves at every pixel, the terms (Bx3xHxW) by name, and the camera's gain. Nothing is
    checked; arguments as for `form`, but for linear light J.
    """
    medium = setting.medium.in_pixels((z.shape[-2], z.shape[-1]), setting.view).to(z)
    T = setting.curves(medium, z, metres)
    gain = setting.development.gain(J, z, medium, T)
    soft = blurred_as_seen(J, z, medium, _plan(z, medium, setting.light, gain, tolerance))
    T = snowing(T, medium, setting.light, z, setting.view, metres, J) or medium.curves(z)
    return T, medium.parts(z, J, soft, T), gain


@dataclass(frozen=True, eq=False)
class Terms:
    """The terms of an image and their sum, each (BxCxHxW) in linear light."""

    direct: Tensor
    forward: Tensor
    backscatter: Tensor
    image: Tensor

    def __iter__(self) -> Iterator[Tensor]:
        names = (field.name for field in fields(self) if field.name != "image")
        return (getattr(self, name) for name in names)


def form_image(
    image: Tensor,
    distance: Tensor,
    medium: Medium,
    *,
    light: Light | None = None,
    view: View = WIDE,
    tolerance: float = 0.002,
) -> Terms:
    """The terms of an underwater image, in linear light.

    Args:
        image (Bx3xHxW or 3xHxW tensor): J, linear light, 1 = white plate at the surface; may exceed
            [0, 1].
        distance (Bx1xHxW or 1xHxW tensor): z, metres along the ray, ≥ 0, times the medium field if
            the water is uneven; +inf is open water. A batch of 1 serves all images.
        medium: one row, or as many as images. One image and B media give B images.
        light: lamps, and the direction of daylight; None for daylight as the medium has it.
        view: of the camera.
        tolerance: RMSE of the blur that may pass, in linear light, on pictures with power ∝ 1/f².

    Returns:
        The terms, of the image's dtype, with its batch dimension or without.

    Raises:
        TypeError, ValueError: if types or shapes disagree, a value of the image is NaN or infinite,
            a distance NaN or negative, or most distances lie beyond 1000 m.

    Source: "Sea-ing Through Scattered Rays" (2025), with a sign of the forward term corrected.
    """
    checks.floating("image", image)
    validate(image, distance, medium, color_space="linear", light=light, view=view)
    with checks.full_precision(image):
        J = image if image.ndim == 4 else image[None]
        dtype = torch.promote_types(image.dtype, torch.float32)
        z = effective_distance(distance, None, dtype)
        if J.numel() == 0 or z.numel() == 0:
            return Terms(**{field.name: _nothing(J, z) for field in fields(Terms)})
        J = J.to(dtype)
        setting = Setting(medium, light, view=view, color_space="linear")
        terms = terms_of(J, z, setting, tolerance=tolerance)[1]
        terms["image"] = sum(list(terms.values())[1:], terms["direct"])
    rows = 0 if image.ndim == 3 and len(terms["image"]) == 1 else slice(None)
    return Terms(**{name: term.to(image.dtype)[rows] for name, term in terms.items()})


def form_each(images: Tensor, z: Tensor, metres: Tensor, settings: Sequence[Setting]) -> Tensor:
    """Pictures (Bx3xHxW) as cameras store them, see `form`.

    On the host they are formed one after the other, which keeps the data of one in the caches. On a
    device pictures by daylight alone are formed at once, then those with lamps one by one, without
    a look at values: blurs are planned for the `span` of each, in a scene of grey.
    """
    results: dict[int, Tensor] = {}
    on_host = checks.on_host(images)
    for indices in () if on_host else _days(settings):
        rows = slice(None) if len(indices) == len(images) else indices
        pictures = _at_once(images[rows], z[rows], metres[rows], [settings[i] for i in indices])
        results |= dict(zip(indices, torch.split(pictures, 1), strict=True))
    for i, setting in enumerate(settings):
        if i in results:
            continue
        plans = list[BlurPlan]()
        if setting.light is not None and not on_host:
            plans = _plans(_lit_grey(setting, z.shape[-1]), [setting], z)
        row = slice(i, i + 1)
        results[i] = form(images[row], z[row], setting, metres=metres[row], plans=plans)
    ordered = [results[i] for i in range(len(images))]
    return ordered[0] if len(ordered) == 1 else torch.cat(ordered)


def _days(settings: Sequence[Setting]) -> list[list[int]]:
    """Indices of pictures that can be formed at once: by daylight alone, of one law of widths,
    metered or not, and at most of other pitches.
    """
    days: dict[Any, list[int]] = {}
    for i, setting in enumerate(settings):
        light, development = setting.light, setting.development
        of_one_pitch = light is None or (not light.lamps and isinstance(light.pitch, float))
        if of_one_pitch and not isinstance(development.white_balance, tuple):
            daylight = None if light is None else light.daylight
            key = daylight, setting.view, setting.medium.law, development.metered
            days.setdefault(key, []).append(i)
    return list(days.values())


def _at_once(images: Tensor, z: Tensor, metres: Tensor, settings: Sequence[Setting]) -> Tensor:
    medium = Medium.stack([setting.medium for setting in settings])
    development = Development.stack([setting.development for setting in settings], z)
    light, day = settings[0].light, medium
    if light is not None:
        light = replace(light, pitch=torch.tensor([x.light.pitch for x in settings if x.light]))
        day = medium.brightened(torch.full((1, 1), light.daylight))
    stacked = replace(settings[0], medium=medium, light=light, development=development)
    plans = _plans(_of_grey(day, settings), settings, z)
    return form(images, z, stacked, metres=metres, plans=plans)


def _plans(media: Medium, settings: Sequence[Setting], z: Tensor) -> list[BlurPlan]:
    """Blurs of pictures of the size of a map, for media as cameras brighten them."""
    demands = [
        blur_demand(media[i], (setting.span[0], setting.span[2]), view=setting.view)
        for i, setting in enumerate(settings)
    ]
    return [demand.plan((z.shape[-2], z.shape[-1]), shared=True) for demand in demands]


def _lit_grey(setting: Setting, width: int) -> Medium:
    """The medium as a camera brightens it where lamps light a grey wall at the median distance."""
    assert setting.light is not None
    metres = min(setting.span[1], FARTHEST)
    z = torch.full((1, 1, *_WALL_PX), metres, dtype=torch.float64)
    grey, water = z.new_full((1, 3, *_WALL_PX), _GREY), setting.medium.to(z)
    T = setting.light.curves(water, z, setting.view.resized(_WALL_PX[1] / width))
    gain = setting.development.gain(grey, z, water, T)
    return setting.light.planned(water).brightened(gain)


def _of_grey(medium: Medium, settings: Sequence[Setting]) -> Medium:
    """Media as a camera brightens them where the scene is grey and all at its median distance."""
    rows = torch.tensor([setting.span for setting in settings], dtype=torch.float64)
    z = rows[:, 1, None, None, None].clamp(max=FARTHEST)
    grey = z.new_full((len(z), 3, 1, 1), _GREY)
    arriving = medium.image(z, grey, grey).flatten(1)
    brightest = arriving.amax(1, keepdim=True)
    means = Means(grey.flatten(1), arriving, arriving.clamp(min=0.0), brightest)
    development = Development.stack([setting.development for setting in settings], z)
    return medium.brightened(development.gain_of(means, z))
