"""A camera that is off, or loses its power: what its node tells the operator, and how it comes back by itself."""

FRAME_S, PACKETS = 0.08, 59  # that sending a frame takes, in a period of 0.1 s: a power cut falls in the middle of one
SENDING = {"frame_rate": 10.0, "packet_size": 900, "packet_delay_ns": round(FRAME_S / PACKETS * 1e9)}


def test_camera_that_is_off_is_awaited_and_a_power_cut_in_the_middle_of_a_frame_is_survived_and_timed(
    gige_camera, bench, monkeypatch
):
    monkeypatch.setattr("camera_client.sources.supervised_source.RETRY_S", 0.1)
    simulated = gige_camera()
    simulated.power_off()
    aravis = {"address": simulated.address, "frame_retention_ms": 200.0, **SENDING}
    camera = bench(camera_name="cam01", source="aravis", **{f"aravis.{key}": value for key, value in aravis.items()})
    camera.start()
    camera.until_said("no camera: ")
    (status,) = camera.diagnostics[-1].status
    assert status.level == status.ERROR and simulated.address in status.message
    simulated.power_on()
    camera.until(lambda: camera.values()["link"] == "streaming" and "last_outage_s" in camera.values())
    for _ in range(5):  # on a busy machine the power may go between two frames
        before, sent = camera.values(), simulated.counters["frames_sent"]
        camera.until(lambda sent=sent: simulated.counters["frames_sent"] > sent)
        simulated.power_off()
        camera.until_said("no camera: ")
        simulated.power_on()
        camera.until(lambda last=before["last_outage_s"]: camera.values()["last_outage_s"] != last)  # frames come again
        after = camera.values()
        more = {key: float(after[key]) - float(before[key]) for key in ("incomplete", "reconnects", "downtime_s")}
        if more["incomplete"]:
            break
    assert more["incomplete"] > 0 and more["reconnects"] > 0
    assert more["downtime_s"] > float(after["last_outage_s"]) - 0.1
    expected, *parts = (int(after[key]) for key in ("expected", "delivered", "incomplete", "lost"))
    assert expected == sum(parts)
