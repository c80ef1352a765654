"""Maps of distances over one of which the process dies, as damaged files can make decoders do."""

import os
import signal
from typing import Any

from uwaug.jobs import DistanceFormat


class Deadly(DistanceFormat):
    def read(self, file: Any, size: Any, **options: Any) -> Any:
        if "deadly" in str(file.name):
            os.kill(os.getpid(), signal.SIGKILL)
        return super().read(file, size, **options)
