"""Run an exported file like the module that it came from."""

import os
from typing import Any

import torch
from torch import Tensor

from uwaug._support.onnx_session import Session
from uwaug.formation.colour import to_light
from uwaug.formation.inputs import validate
from uwaug.onnx.graph import parameters_of
from uwaug.onnx.metadata import read_metadata, stored_in
from uwaug.optics.medium import Medium
from uwaug.optics.surfaces import as_matrices


class OnnxUnderwater:
    """Run an exported file like the module that it came from.

    The session is opened at the first call and not pickled, so that the object can live in
    DataLoader workers.

    Args:
        path: of the file.
        threads: of ONNX Runtime; 0 lets it choose. In DataLoader workers, 1.

    Attributes:
        metadata: what the file says of itself, see `read_metadata`.

    Raises:
        ImportError, OSError, ValueError: as `read_metadata`; and if onnxruntime is not installed.
    """

    def __init__(self, path: str | os.PathLike[str], threads: int = 0) -> None:
        self.metadata = read_metadata(path)
        self.stored = stored_in(path, self.metadata)
        self.session = Session(path, threads)

    def __repr__(self) -> str:
        return f"OnnxUnderwater({str(self.session.path)!r}: {self.metadata['uwaug_medium']})"

    def __call__(
        self,
        image: Tensor,
        distance: Tensor,
        field: Tensor | None = None,
        medium: Medium | None = None,
    ) -> Tensor:
        """Degrade an image.

        Args:
            image (Bx3xHxW or 3xHxW tensor): float32 or uint8, as the file was exported.
            distance (Bx1xHxW or 1xHxW tensor): metres, ≥ 0; +inf is open water.
            field (as distance): if the file has it as an input.
            medium: if the file has its parameters as inputs; one, or one for each image.

        Raises:
            TypeError, ValueError: as `Underwater` would; and if an argument is lacking, or more
                than the file takes.
        """
        self._require("field", field, wanted="input")
        self._require("parameters", medium, wanted="inputs", name="medium")
        rows = self._rows(image, distance, field, medium)
        if medium is not None:
            rows |= self._parameters(medium)
        sizes = [len(row) for row in rows.values()]
        # all batches are 1 or one common size; if that is 0, the result is empty
        batch = min(sizes) if 0 in sizes else max(sizes)
        if image.numel() == 0 or batch == 0:
            return image.new_zeros(batch, 3, *image.shape[-2:])
        # one by one: all at once takes up to 1.15 times as long on one thread, and .9 on two
        results = []
        for i in range(batch):
            one = {
                name: value[i : i + 1] if len(value) > 1 else value for name, value in rows.items()
            }
            results.append(self.session(one))
        result = results[0] if batch == 1 else torch.cat(results)
        return result[0] if image.ndim == 3 and batch == 1 else result

    def _require(self, key: str, value: Any, *, wanted: str, name: str = "") -> None:
        """Refuse an input that the file does not take, or the lack of one that it does."""
        exported = self.metadata[f"uwaug_{key}"]
        if (value is not None) != (exported == wanted):
            verb = "needs one" if value is None else "takes none"
            raise ValueError(
                f"{name or key}: the file {verb}, as it was exported with {key}={exported!r}"
            )

    def _parameters(self, medium: Medium) -> dict[str, Tensor]:
        """The numbers of a medium as the file takes them."""
        stored = self.stored.setup.medium
        law, kind = medium.point_spread, stored.point_spread
        if (law.shape, law.reference_size) != (kind.shape, kind.reference_size):
            wanted = f"shape {kind.shape!r} and reference_size {kind.reference_size}"
            raise ValueError(f"medium: its point spread is {law}, but the file is for {wanted}")
        if medium.is_spectral and not stored.is_spectral:
            got = "the file is for media of grey surfaces, got one of surfaces with spectra"
            raise ValueError(f"medium: {got}: export with surfaces='spectral'")
        parameters = parameters_of(medium)
        if stored.is_spectral:
            for name in ("direct_weights", "signal_weights"):
                parameters[name] = as_matrices(parameters[name])
        return parameters

    def _rows(
        self, image: Tensor, distance: Tensor, field: Tensor | None, medium: Medium | None
    ) -> dict[str, Tensor]:
        """The pictures as the file takes them, with a batch dimension."""
        dtype = torch.uint8 if self.stored.options.image == "uint8" else torch.float32
        got = image.dtype if isinstance(image, Tensor) else type(image).__name__
        if got != dtype:
            raise TypeError(f"image must be {dtype} for this file, got {got}")
        # the module's own refusals
        validate(image, distance, medium, field, also_bytes=True)
        if image.numel():
            # and those of values, which hold for all if they hold for the ends
            to_light(torch.stack(image.aminmax()), self.stored.setup.color_space)
        rows = {"image": image, "distance": distance.to(torch.float32)}
        if field is not None:
            rows["field"] = field.to(torch.float32)
        return {name: row if row.ndim == 4 else row[None] for name, row in rows.items()}
