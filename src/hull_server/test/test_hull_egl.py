"""OpenGL without a display: every way to a context, in which order they are tried, and what is said when none works."""

import sys
import threading

import numpy as np
import pytest

from hull_server.opengl.egl import GlContext, NoGraphics

NVIDIA, LLVMPIPE = "NVIDIA GeForce RTX 4070/PCIe/SSE2", "llvmpipe (LLVM 15.0.6, 256 bits)"
NO_DRIVER = NoGraphics("has no driver")


class FakeContext(GlContext):
    """A context on displays that each draw with a renderer, or fail."""

    alive = 0

    def __init__(self, offers, hardware=None):
        self.offers = offers
        super().__init__(hardware)

    def _displays(self, hardware):
        return iter((name, lambda name=name: name) for name in self.offers)

    def _create(self):
        if self.offers[self._display] is NO_DRIVER:
            raise NO_DRIVER
        FakeContext.alive += 1
        return 700

    def _make_current(self, context):
        pass

    def _destroy(self):
        FakeContext.alive -= 1

    def _renderer(self):
        return self.offers[self._display]


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


@pytest.mark.parametrize(
    ("offers", "hardware", "renderer"),
    [
        ({"a": NVIDIA, "b": LLVMPIPE}, None, NVIDIA),
        ({"a": NVIDIA, "b": LLVMPIPE}, False, LLVMPIPE),
        ({"a": NO_DRIVER, "b": LLVMPIPE, "c": "AMD Radeon"}, None, LLVMPIPE),
        ({"a": NO_DRIVER, "b": LLVMPIPE, "c": "AMD Radeon"}, True, "AMD Radeon"),
    ],
)
def test_context_is_that_of_the_first_display_of_the_wanted_kind(offers, hardware, renderer):
    context = FakeContext(offers, hardware)
    assert (context.renderer, context.is_hardware) == (renderer, renderer != LLVMPIPE)
    assert FakeContext.alive == 1
    context.close()
    context.close()
    assert FakeContext.alive == 0


@pytest.mark.parametrize(
    ("offers", "tried"),
    [
        ({}, "EGL knows no such device"),
        ({"EGL device 0": NO_DRIVER, "default": LLVMPIPE}, f"EGL device 0: has no driver; default: {LLVMPIPE} is soft"),
    ],
)
def test_context_that_cannot_be_had_leaves_nothing_behind_and_names_what_was_tried_and_the_remedy(offers, tried):
    with pytest.raises(NoGraphics) as caught:
        FakeContext(offers, hardware=True)
    text = str(caught.value)
    assert "no hardware OpenGL 4.3 context" in text and tried in text and "/dev/dri/renderD*" in text
    assert FakeContext.alive == 0


def test_context_under_another_pyopengl_platform_or_without_libegl_says_what_to_do(monkeypatch):
    monkeypatch.delattr("OpenGL.EGL", raising=False)
    monkeypatch.setitem(sys.modules, "OpenGL.EGL", None)
    with pytest.raises(NoGraphics, match=r"libEGL.so.1 or PyOpenGL is not installed .*apt install libegl1"):
        GlContext()
    monkeypatch.setenv("PYOPENGL_PLATFORM", "glx")
    with pytest.raises(NoGraphics, match=r"PYOPENGL_PLATFORM is 'glx', not 'egl'.*unset"):
        GlContext()


@pytest.mark.parametrize("way", ["EGL device", "surfaceless EGL", "default EGL display"])
def test_context_on_one_way_alone_works_where_the_driver_offers_it(monkeypatch, request, way):
    every = GlContext._displays
    monkeypatch.setattr(GlContext, "_displays", lambda *args: (d for d in every(*args) if d[0].startswith(way)))
    assert_draws(request.getfixturevalue("context"))


def test_context_serves_threads_one_at_a_time_until_it_is_closed(context):
    busy, overlaps = threading.Lock(), []

    def work():
        for _ in range(20):
            with context.current():
                overlaps.append(not busy.acquire(blocking=False))
                busy.release()
            assert_draws(context)

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(overlaps) == 60 and not any(overlaps)
    context.close()
    with pytest.raises(NoGraphics, match="closed"), context.current():
        pass


def test_storage_buffer_gives_back_what_was_written_and_says_when_there_is_no_room(context, monkeypatch):
    from hull_server.opengl.gl_buffers import GL, StorageBuffer

    def out_of_memory(*args):
        raise GL.GLError(GL.GL_OUT_OF_MEMORY)

    data = np.arange(1000, dtype=np.uint32)
    with context.current():
        buffer = StorageBuffer(data)
        buffer.write(data[:10] + 7)
        found = buffer.read(np.uint32, 1000)
        with pytest.raises(ValueError, match=r"4004 bytes do not fit a buffer of 4000"):
            buffer.read(np.uint32, 1001)
        monkeypatch.setattr(GL, "glBufferData", out_of_memory)
        with pytest.raises(NoGraphics, match=r"no room for 4000 bytes"):
            StorageBuffer(4000)
    assert np.array_equal(found[:10], data[:10] + 7) and np.array_equal(found[10:], data[10:])


def test_shader_that_does_not_compile_is_an_error_with_the_drivers_words(context):
    from hull_server.opengl.gl_buffers import make_program

    with context.current(), pytest.raises(NoGraphics, match=r"(?s)the driver rejects a compute shader: .*nonsense"):
        make_program(compute="#version 430\nlayout(local_size_x = 1) in;\nvoid main() { nonsense(); }\n")
