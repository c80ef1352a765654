"""A session of ONNX Runtime for the processes of a DataLoader."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from uwaug._support.atomic import require_regular
from uwaug._support.extras import require

# sessions of the parent process, kept: to end one here would wait for threads that are there
_inherited: list[Any] = []


class Session:
    """File that ONNX Runtime runs. It opens at first use, in each process anew. 0 `threads` let
    ONNX Runtime choose; None takes as many as torch has then.
    """

    def __init__(
        self, path: str | os.PathLike[str], threads: int | None = 0, *, optimise: bool = True
    ) -> None:
        self.path, self.threads, self.optimise = Path(path), threads, optimise
        self._opened: Any = None
        self._process = os.getpid()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_opened": None}

    @property
    def opened(self) -> Any:
        """The `onnxruntime.InferenceSession`; a ValueError if the file cannot be loaded."""
        if self._opened is not None and self._process != os.getpid():
            _inherited.append(self._opened)
            self._opened = None
        if self._opened is None:
            self._opened, self._process = self._open(), os.getpid()
        return self._opened

    def _open(self) -> Any:
        (ort,) = require("onnx", "onnxruntime")
        require_regular(self.path)
        options = ort.SessionOptions()
        options.log_severity_level = 3
        threads = self.threads
        options.intra_op_num_threads = torch.get_num_threads() if threads is None else threads
        # threads that spin while they wait halve the speed of whatever runs beside them: two on two
        # cores then take 8 ms for our file of 256² instead of 5
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        if not self.optimise:
            options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        try:
            return ort.InferenceSession(str(self.path), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its exceptions have no common base
            reason = str(error).splitlines()[0]
            raise ValueError(f"{self.path}: ONNX Runtime cannot load it: {reason}") from error

    def __call__(self, inputs: Mapping[str, Tensor]) -> Tensor:
        """Return the first output for the inputs by name."""
        feed = {name: value.detach().cpu().contiguous().numpy() for name, value in inputs.items()}
        return torch.from_numpy(self.opened.run(None, feed)[0])
