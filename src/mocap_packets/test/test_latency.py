"""The two halves of a set's times meet, whichever comes first; a half without the other is forgotten."""

from mocap_packets.latency import POINTS, SETS_KEPT, HullTimes, LatencyMatcher, SetLatency

MS = 1_000_000


def test_halves_meet_whichever_comes_first():
    book, whole = LatencyMatcher(), SetLatency(100, 100 + 9 * MS, 100 + 15 * MS, 100 + 20 * MS, 100 + 21 * MS)
    assert book.left_hull(HullTimes(100, 100 + 9 * MS, 100 + 15 * MS)) is None
    assert book.answered(100, 100 + 20 * MS, 100 + 21 * MS) == whole
    assert book.answered(100, 100 + 20 * MS, 100 + 21 * MS) is None
    assert book.left_hull(HullTimes(100, 100 + 9 * MS, 100 + 15 * MS)) == whole
    assert whole.ages_ms() == dict(zip(POINTS, (9.0, 15.0, 20.0, 21.0), strict=True))


def test_sets_that_are_never_answered_are_forgotten():
    book = LatencyMatcher()
    for stamp in range(SETS_KEPT + 1):
        book.left_hull(HullTimes(stamp, stamp, stamp))
    assert book.answered(0, 1, 2) is None and book.answered(1, 2, 3) is not None


def test_halves_of_sets_before_a_new_beginning_join_none_of_the_same_stamp():
    book = LatencyMatcher()
    book.left_hull(HullTimes(100, 100 + 9 * MS, 100 + 15 * MS))
    book.forget()
    assert book.answered(100, 100 + 20 * MS, 100 + 21 * MS) is None
