"""Setting features, against a device made of Python: what is sent, and what a refusal says."""

import math

import pytest

from camera_client.frame_source import SourceUnavailable
from camera_client.gige.features import DeviceRefusal, Features, Kind
from camera_client.gige.triggers import TIMER_LEAD_NS, await_ptp, synchronise
from camera_client.settings import AravisSettings
from capture_rig.errors import InputError


class Device:
    """Features by name: kind, value, limits, step, choices; and quirks of real cameras."""

    def __init__(self, **features):
        self.features = features
        self.log = []
        self.locked, self.rounding = set(), {}

    def kind(self, name):
        return self.features[name]["kind"] if name in self.features else None

    def read(self, name):
        return self.features[name]["value"]

    def write(self, name, value):
        if name in self.locked:
            raise DeviceRefusal("access denied (0x8006)")
        self.log.append((name, value))
        self.features[name]["value"] = self.rounding.get(name, lambda v: v)(value)

    def execute(self, name):
        if name in self.locked:
            raise DeviceRefusal("busy (0x8007)")
        self.log.append(name)

    def limits(self, name):
        return self.features[name].get("limits")

    def step(self, name):
        return self.features[name].get("step")

    def choices(self, name):
        return self.features[name]["choices"]


def feature(kind, value=None, **more):
    return {"kind": kind, "value": value, **more}


@pytest.fixture
def device():
    return Device(
        ExposureTimeAbs=feature(Kind.FLOAT, 1000.0, limits=(20.0, 1e6)),
        Width=feature(Kind.INTEGER, 640, limits=(16, 1280), step=16),
        GevSCDA=feature(Kind.INTEGER, 0),
        PixelFormat=feature(Kind.ENUMERATION, "Mono8", choices=("Mono8", "Mono12")),
        ReverseX=feature(Kind.BOOLEAN, False),
        DeviceUserID=feature(Kind.STRING, ""),
        UserSetLoad=feature(Kind.COMMAND),
    )


@pytest.fixture
def features(device):
    return Features(device, "camera X")


def test_lines_are_applied_in_order_each_as_its_kind(device, features):
    lines = ["ReverseX = yes", "UserSetLoad!", "Width=0x140", "PixelFormat=Mono12", "DeviceUserID=a=b"]
    lines.append("ExposureTime=5e3")
    features.apply(lines, "aravis.features")
    assert device.log == [
        ("ReverseX", True),
        "UserSetLoad",
        ("Width", 320),
        ("PixelFormat", "Mono12"),
        ("DeviceUserID", "a=b"),
        ("ExposureTimeAbs", 5000.0),
    ]


def test_old_name_is_used_where_the_camera_has_no_new_one(device, features):
    features.set("ExposureTime", 300, "k")
    device.features["ExposureTime"] = feature(Kind.FLOAT, 1.0)
    features.set("ExposureTime", 300, "k")
    features.set("ExposureTimeAbs", 300, "k")
    assert [name for name, _ in device.log] == ["ExposureTimeAbs", "ExposureTime", "ExposureTimeAbs"]


def test_integers_are_put_on_the_grid_and_floats_may_be_rounded_by_the_camera_and_no_more(device, features):
    assert features.set("Width", 650, "k") == 656
    device.rounding["ExposureTimeAbs"] = lambda value: round(value / 33) * 33.0
    assert features.set("ExposureTime", 5000.0, "k") == 5016.0
    device.rounding["ExposureTimeAbs"] = lambda value: min(value, 2000.0)
    said = r"camera X: took ExposureTimeAbs = 2000.0 instead of 5000.0. Allowed: 20 to 1e\+06. Set k to"
    with pytest.raises(InputError, match=said):
        features.set("ExposureTime", 5000.0, "k")


@pytest.mark.parametrize(
    "name, value, message",
    [
        ("Width", "wide", "Width = 'wide' is no integer"),
        ("Width", 1.5, "is no integer"),
        ("ExposureTime", math.nan, "is no float"),
        ("ReverseX", "maybe", "is no boolean"),
        ("Nothing", 1, "has no feature Nothing, which k needs"),
        ("PtpEnable", 1, "has no feature PtpEnable or GevIEEE1588, which k needs"),
    ],
)
def test_impossible_value_is_refused_before_it_is_sent(device, features, name, value, message):
    with pytest.raises(InputError, match=message):
        features.set(name, value, "k")
    assert device.log == []


def test_feature_that_can_only_be_written_is_believed(device, features):
    def refuse(name):
        raise DeviceRefusal("write only")

    device.read = refuse
    assert features.set("GevSCDA", 7, "k") == 7
    assert device.log == [("GevSCDA", 7)]


def test_what_is_so_already_is_not_written(device, features):
    device.locked.add("PixelFormat")
    features.ensure("PixelFormat", "Mono8", "k")
    features.ensure("Nothing", 1, "k")
    assert device.log == []
    with pytest.raises(InputError, match="refuses PixelFormat"):
        features.ensure("PixelFormat", "Mono12", "k")


def test_locked_feature_is_refused_with_the_device_s_own_words(device, features):
    device.locked |= {"Width", "UserSetLoad"}
    with pytest.raises(InputError, match=r"refuses Width = 320 \(access denied \(0x8006\)\).*Change k"):
        features.set("Width", 320, "k")
    for line, said in {
        "UserSetLoad!": "refuses UserSetLoad! ",
        "UserSetLoad=1": "is a command",
        "Gain": "k holds 'Gain'",
    }.items():
        with pytest.raises(InputError, match=said):
            features.apply([line], "k")


@pytest.mark.parametrize(
    "kind, choices, written",
    [
        (Kind.BOOLEAN, (), True),
        (Kind.INTEGER, (), 1),
        (Kind.ENUMERATION, ("Off", "On"), "On"),
        (Kind.ENUMERATION, ("False", "True"), "True"),
    ],
)
def test_switch_finds_the_camera_s_word_for_on(kind, choices, written):
    device = Device(PtpEnable=feature(kind, None, choices=choices))
    Features(device, "X").switch("PtpEnable", True, "k")
    assert device.log == [("PtpEnable", written)]


def test_camera_with_a_free_run_timer_begins_at_a_multiple_of_the_period_of_the_ptp_clock():
    words = ("TriggerRateAbs", "StartTimeLow", "StartTimeHigh")
    timer = {f"SyncFreeRunTimer{word}": feature(Kind.INTEGER, 0) for word in words}
    device = Device(
        SyncFreeRunTimerEnable=feature(Kind.BOOLEAN, False), SyncFreeRunTimerUpdate=feature(Kind.COMMAND), **timer
    )
    now_ns = 1_800_000_000_003_000_000
    synchronise(Features(device, "X"), AravisSettings(sync="ptp", frame_rate=50.0), lambda: now_ns)
    (rate, low, high), (update, enable) = device.log[:3], device.log[3:]
    start_ns = high[1] << 32 | low[1]
    assert rate[1] == 50 and start_ns % 20_000_000 == 0 and 0 < start_ns - now_ns - TIMER_LEAD_NS <= 20_000_000
    assert (update, enable) == ("SyncFreeRunTimerUpdate", ("SyncFreeRunTimerEnable", True))


class PtpDevice(Device):
    """Reaches Slave when its status was asked for ``after`` times."""

    def __init__(self, after):
        super().__init__(
            GevIEEE1588=feature(Kind.BOOLEAN, False),
            GevIEEE1588Status=feature(Kind.ENUMERATION, "Disabled", choices=()),
            GevIEEE1588DataSetLatch=feature(Kind.COMMAND),
        )
        self.after = after

    def read(self, name):
        if name == "GevIEEE1588Status" and self.features["GevIEEE1588"]["value"]:
            self.after -= 1
            return "Slave" if self.after < 0 else "Listening"
        return super().read(name)


def test_ptp_that_never_comes_is_given_up_and_a_camera_without_it_refused():
    slept = []
    settings = AravisSettings(sync="ptp", ptp_wait_s=2.0)
    with pytest.raises(SourceUnavailable, match=r"X: is not in step by PTP after 2 s \(status Listening\).* sync ptp"):
        await_ptp(Features(PtpDevice(after=10**6), "X"), settings, lambda: sum(slept), slept.append)
    assert sum(slept) == pytest.approx(2.0, abs=0.1)
    with pytest.raises(InputError, match="has no PTP"):
        await_ptp(Features(Device(), "X"), settings)
