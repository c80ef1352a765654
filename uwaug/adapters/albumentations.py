"""`RandomUnderwater` for Albumentations 2.x and AlbumentationsX."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from uwaug._support import checks
from uwaug._support.extras import install
from uwaug.formation.colour import luminance
from uwaug.transforms.draws import Record
from uwaug.transforms.keep_visible import means_over
from uwaug.transforms.random_underwater import RandomUnderwater
from uwaug.transforms.scenes import Scenes

try:
    from albumentations import ImageOnlyTransform
except ImportError as missing:
    raise ImportError(f"{missing.name} is missing: {install('albumentations')}") from missing

# kinds of targets that move with pictures and keep their values
_MASKS = ("mask", "masks", "mask3d", "masks3d")


class _Hooks:
    """Hooks of both libraries. AlbumentationsX refuses `get_params` on a transform's own class."""

    augment: RandomUnderwater
    random_generator: np.random.Generator
    _in_pipeline = False

    def set_processors(self, processors: dict[str, Any]) -> None:
        """Note that there is a pipeline, which calls this."""
        super().set_processors(processors)  # type: ignore[misc]
        self._in_pipeline = True

    def get_params(self) -> dict[str, Any]:
        """Draw a record, for Albumentations."""
        return self._draw(self.random_generator)

    def sample_parameters(self, params: Any, data: Any, targets: Any, sampling: Any) -> Any:
        """Draw a record, for AlbumentationsX."""
        from albumentations.core.transform_params import SampledParams

        self._in_pipeline |= sampling.invocation.root_key is not None
        return SampledParams(self._draw(sampling.random_generator))

    def _draw(self, random: np.random.Generator) -> dict[str, Any]:
        generator = torch.Generator().manual_seed(int(random.integers(2**32)))
        return {"record": self.augment.make_params(torch.empty(3, 1, 1), generator)}


class AlbumentationsUnderwater(_Hooks, ImageOnlyTransform):  # type: ignore[misc]
    """Transform that degrades pictures in an Albumentations pipeline.

    Args:
        augment: a `RandomUnderwater`, or its options as a dict. Its `p` has to be 1.
        distance_key: name of the map (HxW) of image in a call; a pipeline needs it in
            `additional_targets={"distance": "mask"}`. The picture image2 has the map distance2;
            left has distance_left; `images` (NxHxWx3) have `distances` (NxHxW, of kind "masks").
            AlbumentationsX moves further masks only beside a mask: without one, give the map as
            the mask, by "mask". No map is needed where `augment` makes distances.
        scale: metres per unit of a map, such as .001 for mm.
        channels: order of the picture's colours; "bgr" with OpenCV and Ultralytics. "grey": one
            channel, which stays one: the luminance of the light that its wet picture in colour has.
        min_contrast: contrast below which boxes of `image` go, with their labels, as those of
            `uwaug.KeepVisible`; None keeps all.
        p: probability, as in all transforms of Albumentations.

    Targets:
        image, and others of its kind (`additional_targets`): HxWx3, uint8 (0…255), uint16
        (0…65535) or float32 (0…1); one draw for all, each at its distances. Grey, HxW or HxWx1,
        comes out in colour, but by "grey". Pictures of `images` are frames of one film. Masks and
        keypoints stay as they are.

    Random numbers come from the pipeline: `A.Compose(…, seed=…)`. Albumentations 2.0 draws the same
    in all workers of a DataLoader and in all epochs: call
    `pipeline.set_random_seed(torch.initial_seed())` in a `worker_init_fn`. `A.ReplayCompose` keeps
    the draw under "record" in its "replay", but no map.

    Examples:
        >>> import albumentations as A, numpy as np, uwaug
        >>> water = AlbumentationsUnderwater(uwaug.RandomUnderwater(["II", "7C"]), p=1.0)
        >>> targets = {"distance": "mask"}
        >>> pipeline = A.Compose([A.HorizontalFlip(), water], additional_targets=targets, seed=0)
        >>> image, distance = np.full((32, 48, 3), 200, np.uint8), np.full((32, 48), 3.0)
        >>> pipeline(image=image, mask=image[..., 0], distance=distance)["image"].shape
        (32, 48, 3)
    """

    def __init__(
        self,
        augment: RandomUnderwater | Mapping[str, Any] | None = None,
        *,
        distance_key: str = "distance",
        scale: float = 1.0,
        channels: Literal["rgb", "bgr", "grey"] = "rgb",
        min_contrast: float | None = None,
        p: float = 0.5,
    ) -> None:
        checks.within("p", p, 0.0, 1.0)
        checks.within("min_contrast", min_contrast or 0.0, 0.0, 1.0)
        super().__init__(p=p)
        if augment is None or isinstance(augment, Mapping):
            augment = RandomUnderwater.from_dict(augment or {})
        checks.instance("augment", augment, RandomUnderwater, "; hidden boxes go by min_contrast")
        if augment.p != 1:
            raise ValueError(f"augment.p must be 1, got {augment.p}: give p to the adapter instead")
        checks.one_of("channels", channels, ("rgb", "bgr", "grey"))
        checks.positive("scale", scale)
        self.augment = augment
        self.distance_key, self.scale, self.channels = distance_key, scale, channels
        self.min_contrast = min_contrast
        self._moved = set(_MASKS)

    def add_targets(self, additional_targets: dict[str, str]) -> None:
        """Note the arrays that a pipeline moves with the picture."""
        super().add_targets(additional_targets)
        self._moved |= {name for name, kind in additional_targets.items() if kind in _MASKS}

    def apply_with_params(self, params: Any, *args: Any, **kwargs: Any) -> dict[str, Any]:
        """Degrade all pictures of a call as one record says, each with its own map."""
        record = getattr(params, "params", params)["record"]  # AlbumentationsX wraps the dict
        # maps as parameters would be kept for replays, which may be of other pictures
        result = dict(kwargs)
        for name, pictures in kwargs.items():
            if name not in self._key2func or pictures is None:
                continue
            image, distance = np.asarray(pictures), None
            single = self._key2func[name] == self.apply
            if image.ndim == (2 if single else 3):
                image = image[..., None]
            is_grey = self.channels == "grey"
            if is_grey and image.shape[-1] != 1:
                raise ValueError(f"{name} must be grey, as channels say, got {image.shape}")
            if image.shape[-1] == 1:
                image = image.repeat(3, -1)
            if self.augment.distance.reads_maps:
                distance = self._distance(name, single, kwargs)
            degraded, scenes = self._degraded(image, record, distance)
            result[name] = degraded.reshape(np.shape(pictures)) if is_grey else degraded
            boxes = kwargs.get("bboxes")
            if name == "image" and self.min_contrast is not None and boxes is not None:
                if not self._in_pipeline:
                    raise ValueError("bboxes are of A.Compose(…, bbox_params=…) alone")
                corners = boxes[:, :4] * (2 * image.shape[1::-1])  # from shares
                contrast = means_over(corners.tolist(), scenes.contrast_map()[0]).numpy()
                result["bboxes"] = boxes[contrast >= self.min_contrast]
        return result

    def _distance(self, name: str, single: bool, targets: Mapping[str, Any]) -> Tensor:
        key = self.distance_key
        key = name.replace("image", key, 1) if "image" in name else f"{key}_{name}"
        if targets.get(key) is None:
            cure = "pass a map, or say RandomUnderwater(distance=MadeUp())"
            raise ValueError(f"{key} is missing, for {name}: {cure}")
        if self._in_pipeline and key not in self._moved:
            cure = (
                f"A.Compose(…, additional_targets={{{key!r}: {'mask' if single else 'masks'!r}}})"
            )
            raise ValueError(f"{key} would not move with {name}: {cure}")
        values = np.squeeze(targets[key]) * self.scale
        return torch.from_numpy(values.astype(np.float32)).unsqueeze(-3)

    def _degraded(
        self, img: NDArray[Any], record: Record, distance: Tensor | None
    ) -> tuple[NDArray[Any], Scenes]:
        step = -1 if self.channels == "bgr" else 1
        has_16_bits = img.dtype == np.uint16
        img = img / np.float32(65535) if has_16_bits else img
        image = torch.from_numpy(np.ascontiguousarray(img[..., ::step])).movedim(-1, -3)
        if image.ndim == 4:
            record = self.augment.for_clip(record, image, distance)
        scenes = self.augment.scenes(image, distance, record)
        wet = scenes.formed()
        if self.channels == "grey":
            wet = luminance(wet, self.augment.development.color_space)
        result = wet.movedim(-3, -1).numpy()
        if has_16_bits:
            result = np.rint(result.clip(0, 1) * 65535).astype(np.uint16)
        return np.ascontiguousarray(result[..., ::step]), scenes

    def get_transform_init_args(self) -> dict[str, Any]:
        """Options by name."""
        names = ("augment", "distance_key", "scale", "channels", "min_contrast")
        return {name: getattr(self, name) for name in names}

    def to_dict_private(self) -> dict[str, Any]:
        """Options for JSON. To read them, this module must be imported."""
        return {**super().to_dict_private(), "augment": self.augment.to_dict()}
