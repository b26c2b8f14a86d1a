"""The busy share of the processors, from what /proc/stat says."""

from sagoma_ros.processor_use import ProcessorUse


def test_share_is_what_was_busy_since_the_last_call(tmp_path):
    stat = tmp_path / "stat"
    stat.write_text("cpu  100 0 50 800 50 0 0 0 0 0\ncpu0 1 2 3\n")
    use = ProcessorUse(stat)
    stat.write_text("cpu  130 10 80 820 60 5 5 0 0 0\ncpu0 1 2 3\n")  # 80 busy ticks, 30 idle ones
    assert use.share() == 80 / 110
    assert use.share() == 0.0  # no tick has passed


def test_share_is_nothing_where_the_system_does_not_tell(tmp_path):
    assert ProcessorUse(tmp_path / "stat").share() == 0.0
