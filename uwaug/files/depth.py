"""Distance maps of pictures by a depth network, written to files once for all runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from uwaug._support import codec
from uwaug._support.atomic import written_whole
from uwaug.distance import Metres, Network, Relative
from uwaug.files.pictures import read_picture
from uwaug.files.record import digest
from uwaug.files.run import Job, Work, run
from uwaug.files.summary import Summary
from uwaug.files.table import Row, require_rows

_WHITE = 65535  # of 16 bits


def write_maps(network: Network, rows: Sequence[Row], out: str | Path, **options: Any) -> Summary:
    """Write the maps of a network as PNG of 16 bits with the names of the pictures, and a record
    beside each.

    Maps of inverse depth are stretched from 0, far, to 65535, near, as their scale means nothing.
    Relative depth, 0…1, becomes 0…65535. Metres become mm, 65.5 m at most.

    Args:
        network: a network in a file.
        rows: pictures, see `propose`.
        out: folder to write to, made if need be.
        options: workers, resume, force and progress, as for `degrade`.

    Raises:
        TypeError: if the network is a function.
        ValueError, OSError: as `degrade`.
    """
    work = _Maps(network, Path(out))
    require_rows(rows)
    jobs = [Job(row, Path(row.name).with_suffix(".png").as_posix()) for row in rows]
    return run(work, jobs, **options)


class _Maps(Work):
    def __init__(self, network: Network, out: Path) -> None:
        plain = codec.to_plain(network)  # refuses a function
        assert network.file is not None
        super().__init__(out, {"network": {**plain, "model": digest(network.file)}})
        self.network = network

    def make(self, job: Job) -> tuple[NDArray[np.uint16], dict[str, Any]]:
        image = read_picture(job.row.picture)
        image = image.clamp(0, 1) if image.is_floating_point() else image / 255
        return _whole_numbers(self.network(image), self.network), {}

    def write(self, path: Path, result: NDArray[np.uint16], row: Row) -> None:
        with written_whole(path) as part:
            Image.fromarray(result).save(part, "PNG")


def _whole_numbers(depth: Tensor, network: Network) -> NDArray[np.uint16]:
    values = depth[0].double().numpy()
    low, high = float(values.min()), float(values.max())
    if not np.isfinite(high - low):
        raise ValueError(f"the network gives {low} to {high}: expected finite numbers")
    match network.holds:
        case Metres():
            if low < 0:
                raise ValueError(f"the network gives {low:.4g} m: are they metres?")
            values = values * 1000
        case Relative():
            if low < 0 or high > 1:
                raise ValueError(f"the network gives {low:.4g} to {high:.4g}: expected 0…1")
            values = values * _WHITE
        case _:
            values = (values - low) * (_WHITE / (high - low) if high > low else 0.0)
    numbers: NDArray[np.uint16] = np.rint(values.clip(0, _WHITE)).astype(np.uint16)
    return numbers
