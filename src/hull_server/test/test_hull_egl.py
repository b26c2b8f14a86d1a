"""OpenGL without a display: every way to a context, in which order they are tried, and what is said when none works."""

import sys
import threading

import numpy as np
import pytest

import hull_server.opengl.egl
from hull_server.opengl.egl import Display, Egl, GlContext, NoGraphics

DEVICE = Display(1, "EGL device 0")
NVIDIA, LLVMPIPE = "NVIDIA GeForce RTX 4070/PCIe/SSE2", "llvmpipe (LLVM 15.0.6, 256 bits)"


class FakeEgl:
    """An EGL in which everything works, except what a test takes away.

    offers : what each display draws with. surfaceless : whether a context may be current without a surface.
    """

    def __init__(self, offers, *, surfaceless=True, broken=()):
        self.offers, self.surfaceless, self.broken = offers, surfaceless, broken
        self.alive, self.drawing = set(), None

    def displays(self):
        return list(self.offers)

    def create_context(self, display):
        if display.description in self.broken:
            raise NoGraphics("cannot be initialised (EGL_NOT_INITIALIZED)")
        if self.offers[display] is None:
            raise NoGraphics("has no OpenGL 4.3 (EGL_BAD_MATCH)")
        self.alive.add("context")
        return 700

    def make_current(self, display, context):
        self.drawing = self.offers[display] if context else None
        if context and not self.surfaceless:
            raise NoGraphics("its context cannot be made current (EGL_BAD_MATCH)")

    def destroy(self, display, context):
        self.alive.remove("context")


@pytest.fixture
def open_on(monkeypatch):
    """Open a context on a fake EGL."""

    def open_context(egl, hardware=None):
        monkeypatch.setattr(hull_server.opengl.egl, "Egl", lambda: egl)
        monkeypatch.setattr(hull_server.opengl.egl, "renderer_name", lambda: egl.drawing)
        return GlContext(hardware)

    return open_context


def hidden(kept):
    """An Egl that knows only the displays that ``kept`` accepts."""

    class Hiding(Egl):
        def displays(self):
            return [display for display in super().displays() if kept(display)]

    return Hiding


@pytest.fixture
def context():
    """A real context; skips where there is none."""
    try:
        context = GlContext()
    except NoGraphics as error:
        pytest.skip(f"not on this machine: {error}")
    yield context
    context.close()


def assert_draws(context):
    """A buffer can be written and read: the context is real."""
    from hull_server.opengl.gl_buffers import StorageBuffer

    data = np.arange(100, dtype=np.uint32)
    with context.current():
        assert np.array_equal(StorageBuffer(data).read(np.uint32, 100), data)


def test_context_takes_hardware_before_software_and_says_what_it_is(open_on):
    egl = FakeEgl({DEVICE: NVIDIA, Display(2, "EGL device 1", software=True): LLVMPIPE})
    context = open_on(egl)
    assert context.renderer == NVIDIA and context.is_hardware
    software = open_on(FakeEgl(egl.offers), hardware=False)
    assert software.renderer == LLVMPIPE and not software.is_hardware


@pytest.mark.parametrize("broken", [["EGL device 0"], ["EGL device 0", "surfaceless EGL"]])
def test_context_takes_the_next_display_when_one_cannot_be_initialised(open_on, broken):
    displays = [DEVICE, Display(2, "surfaceless EGL"), Display(3, "default EGL display")]
    offers = dict(zip(displays, (NVIDIA, LLVMPIPE, "AMD Radeon"), strict=True))
    assert open_on(FakeEgl(offers, broken=broken)).renderer == (LLVMPIPE if len(broken) == 1 else "AMD Radeon")


def test_context_that_cannot_be_had_leaves_nothing_behind_and_names_what_was_tried_and_the_remedy(open_on):
    software = Display(2, "EGL device 1", True)
    displays = [DEVICE, software, Display(3, "surfaceless EGL"), Display(4, "default EGL display")]
    egl = FakeEgl(dict(zip(displays, (None, LLVMPIPE, LLVMPIPE, NVIDIA), strict=True)), broken=["default EGL display"])
    with pytest.raises(NoGraphics) as caught:
        open_on(egl, hardware=True)
    text = str(caught.value)
    assert "no hardware OpenGL 4.3 context" in text and "EGL device 0: has no OpenGL 4.3 (EGL_BAD_MATCH)" in text
    assert "EGL device 1: is a software renderer" in text and f"surfaceless EGL: {LLVMPIPE} is software" in text
    assert "default EGL display: cannot be initialised" in text and "/dev/dri/renderD*" in text
    assert egl.alive == set()


def test_context_without_any_display_or_surface_says_so(open_on):
    with pytest.raises(NoGraphics, match="EGL knows no device"):
        open_on(FakeEgl({}))
    stubborn = FakeEgl({DEVICE: NVIDIA}, surfaceless=False)
    with pytest.raises(NoGraphics, match=r"EGL device 0: its context cannot be made current \(EGL_BAD_MATCH\)"):
        open_on(stubborn)
    assert stubborn.alive == set()


def test_context_under_another_pyopengl_platform_says_what_to_unset(monkeypatch):
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")
    with pytest.raises(NoGraphics, match=r"PYOPENGL_PLATFORM is 'glx', not 'egl'.*unset"):
        GlContext()


def test_context_without_libegl_or_pyopengl_says_what_to_install(monkeypatch):
    monkeypatch.delattr("OpenGL.EGL", raising=False)
    monkeypatch.setitem(sys.modules, "OpenGL.EGL", None)
    with pytest.raises(NoGraphics, match=r"libEGL.so.1 or PyOpenGL is not installed .*apt install libegl1"):
        GlContext()


@pytest.mark.parametrize("way", ["EGL device", "surfaceless EGL", "default EGL display"])
def test_context_on_one_way_alone_works_where_the_driver_offers_it(monkeypatch, request, way):
    monkeypatch.setattr(hull_server.opengl.egl, "Egl", hidden(lambda display: display.description.startswith(way)))
    assert_draws(request.getfixturevalue("context"))


def test_context_asked_for_hardware_is_hardware_or_says_why_not(context):
    if context.is_hardware:
        with_hardware = GlContext(hardware=True)
        assert with_hardware.is_hardware
        with_hardware.close()
    else:
        with pytest.raises(NoGraphics, match=r"no hardware OpenGL 4.3 context \(.*software"):
            GlContext(hardware=True)


def test_context_may_be_entered_twice_and_closed_twice_but_not_used_afterwards(context):
    from OpenGL import GL

    with context.current():
        with context.current():
            version = GL.glGetString(GL.GL_VERSION)
        assert GL.glGetString(GL.GL_VERSION) == version  # still current after the inner one ended
    context.close()
    context.close()
    with pytest.raises(NoGraphics, match="closed"), context.current():
        pass


def test_context_serves_threads_one_at_a_time(context):
    busy, overlaps = threading.Lock(), []

    def work():
        for _ in range(20):
            with context.current():
                overlaps.append(not busy.acquire(blocking=False))
                assert_draws(context)
                busy.release()

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(overlaps) == 60 and not any(overlaps)


def test_storage_buffer_gives_back_what_was_written(context):
    from hull_server.opengl.gl_buffers import StorageBuffer

    data = np.arange(1000, dtype=np.uint32)
    with context.current():
        buffer = StorageBuffer(data)
        buffer.write(data[:10] + 7)
        found = buffer.read(np.uint32, 1000)
        with pytest.raises(ValueError, match=r"4004 bytes do not fit a buffer of 4000"):
            buffer.read(np.uint32, 1001)
    assert np.array_equal(found[:10], data[:10] + 7) and np.array_equal(found[10:], data[10:])


def test_storage_buffer_for_which_there_is_no_room_is_no_graphics(context, monkeypatch):
    from hull_server.opengl.gl_buffers import GL, StorageBuffer

    def out_of_memory(*args):
        raise GL.GLError(GL.GL_OUT_OF_MEMORY)

    monkeypatch.setattr(GL, "glBufferData", out_of_memory)
    with context.current(), pytest.raises(NoGraphics, match=r"no room for 4000 bytes"):
        StorageBuffer(4000)


def test_shader_that_does_not_compile_is_an_error_with_the_drivers_words(context):
    from hull_server.opengl.gl_buffers import make_program

    with context.current(), pytest.raises(NoGraphics, match=r"(?s)the driver rejects a compute shader: .*nonsense"):
        make_program(compute="#version 430\nlayout(local_size_x = 1) in;\nvoid main() { nonsense(); }\n")
