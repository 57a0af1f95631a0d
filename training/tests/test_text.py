"""Hashing of instructions. The hashes are fixed, because the backend that serves students computes
them with an implementation of its own."""

from training.text import bucket, features, fnv1a, words


def test_words_are_runs_of_ascii_letters_and_digits() -> None:
    assert words("Put the cabinet's top-drawer ON, 2nd!") == [
        "put", "the", "cabinet", "s", "top", "drawer", "on", "2nd",
    ]  # fmt: skip
    assert words("café") == ["caf"]
    assert words("\u212aettle") == ["ettle"], "the Kelvin sign is no k"
    assert words(" ,;") == []


def test_the_hash_is_fnv_1a() -> None:
    # Test vectors of the hash's authors.
    assert fnv1a("") == 0x811C9DC5
    assert fnv1a("a") == 0xE40C292C
    assert fnv1a("foobar") == 0xBF9CF968


def test_words_and_pairs_have_their_rows() -> None:
    assert [bucket(feature) for feature in ("bowl", "plate", "the bowl", "turn on")] == [
        2693,
        1027,
        2884,
        391,
    ]
    assert features("turn on the stove") == ([634, 4048, 540, 1442], [391, 2635, 585])
    assert features("stop") == ([bucket("stop")], [])
    assert features("") == ([], [])
