def test_name():
    assert __name__ == "x"
