import pytest

from uwaug.optics.medium import Medium
from uwaug.optics.water import Water


@pytest.fixture
def coastal() -> Medium:
    return Medium.from_water(Water.jerlov("3C"))
