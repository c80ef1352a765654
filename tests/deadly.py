"""Maps of distances over one of which the process dies, as damaged files can make decoders do."""

import os
import signal
from pathlib import Path
from typing import Any

from uwaug.jobs import Depth


class Deadly(Depth):
    def read(self, where: Path | float | None, image: Any) -> Any:
        if where == 6.66:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().read(where, image)
