import uwaug
from uwaug._support.cache import caches, clear


def test_every_cache_of_the_process_is_emptied() -> None:
    uwaug.Medium.from_water("7C").under()
    uwaug.Water.jerlov("7C").with_visibility(2.0)
    kept = caches()
    for name in ("optics.bands._reduced", "optics.camera.response_at", "optics.water._eye"):
        assert kept[f"uwaug.{name}"].cache_info().currsize > 0
    clear()
    assert kept["uwaug.optics.bands._reduced"].cache_info().currsize == 0
    assert kept["uwaug.blur.banded._CACHE"].held == 0
