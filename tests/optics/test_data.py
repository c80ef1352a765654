"""Tables of the package, against the packages that they are from."""

import jerlov
import numpy as np
import pytest

from uwaug.optics.constituents import pure_water
from uwaug.optics.jerlov import SOURCES, repaired_table
from uwaug.optics.water import eye

# who fills the gaps of a source; those of b are reconstructed by `jerlov` itself
REPAIRS = {
    ("solonenko2015", "a"): "williamson2022",
    ("solonenko2015", "kd"): "jerlov1976",
    ("williamson2022", "kd"): "jerlov1976",
}


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.filterwarnings("ignore::jerlov.ProvenanceWarning")
def test_jerlov_types(source: str) -> None:
    for type in jerlov.SOURCES[source].water_types:
        nm, spectra, _ = repaired_table(type, source)
        grid = jerlov.water(type, source=source).wavelengths
        np.testing.assert_array_equal(nm, grid[(grid >= nm[0]) & (grid <= 700)])
        for key, values in spectra.items():
            try:
                printed = getattr(jerlov.water(type, source=source), key)(nm)
            except jerlov.MissingQuantityError:
                printed = np.full(nm.size, np.nan)
            gaps = np.isnan(printed)
            if gaps.any():
                repair = jerlov.water(type, source=REPAIRS[source, key])
                printed[gaps] = getattr(repair, key)(nm[gaps])
            np.testing.assert_array_equal(values, printed)


def test_pure_water_and_the_observer() -> None:
    nm = np.linspace(300, 800, 1234)
    absorption, scattering = pure_water(nm.tobytes())
    np.testing.assert_array_equal(absorption, jerlov.pure_water_absorption(nm))
    np.testing.assert_allclose(scattering, jerlov.pure_water_scattering(nm), rtol=1e-14)
    with pytest.raises(ValueError, match="300–800 nm, got 299–500 nm"):
        pure_water(np.array([299.0, 500.0]).tobytes())
    nodes, weights = eye(400, 700)
    observer, xyz = jerlov.cie_1931_cmf()
    expected = np.interp(nodes, observer, xyz[:, 1])
    np.testing.assert_array_equal(weights, expected / expected.sum())
