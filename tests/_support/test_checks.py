from uwaug._support.checks import alike


def test_alike():
    assert alike({"a": (1.0, [2.0, None])}, {"a": [1.0 + 1e-8, (2.0, None)]})
    assert not alike({"a": 1.0}, {"b": 1.0})
    assert not alike({"a": 1.0}, {"a": 1.001})
    assert not alike((1.0, 2.0), (1.0,))
    assert not alike("srgb", "linear")
