import pytest

from uwaug._support.once import Once, muted


def test_warns_once_and_at_one_of_the_first_looks(nothing_is_said: None) -> None:
    blank = Once(looks=3)
    assert blank.due()
    with pytest.warns(UserWarning, match="nothing is left") as said:
        blank.warn("nothing is left", stacklevel=1)
    assert said[0].filename == __file__
    blank.warn("nothing is left")  # silent: a warning would be an error
    assert not blank.due()
    rare = Once(looks=3)
    assert [rare.due() for _ in range(5)] == [True] * 3 + [False] * 2
    with pytest.warns(UserWarning, match="at the last look"):
        rare.warn("at the last look")


def test_trials_neither_count_nor_warn(nothing_is_said: None) -> None:
    blank = Once(looks=1)
    with muted():
        assert not blank.due()
        blank.warn("of a trial")
    assert blank.due()
    with pytest.warns(UserWarning, match="of a picture"):
        blank.warn("of a picture")
