from uwaug._support.cache import Cache


def test_what_was_used_last_stays() -> None:
    cache: Cache[str] = Cache(100)
    for name in "abc":
        cache.put(name, name.upper(), 33)
    assert cache.get("a") == "A"
    cache.put("d", "D", 33)
    assert [cache.get(name) for name in "abcd"] == ["A", None, "C", "D"]
    assert cache.held == 99


def test_a_value_put_again_counts_once_and_a_large_one_alone() -> None:
    cache: Cache[int] = Cache(100)
    for size in (60, 80, 20):
        cache.put("a", size, size)
    assert (cache.get("a"), cache.held) == (20, 20)
    cache.put("b", 0, 500)
    assert (cache.get("a"), cache.get("b"), cache.held) == (None, 0, 500)
    cache.put("c", 1, 1)
    assert (cache.get("b"), cache.held) == (None, 1)
