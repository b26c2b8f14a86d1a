"""OpenGL without a display: what is there, and what is said when it is not."""

import ctypes

import numpy as np
import pytest

from hull_server.egl import GlContext, NoGraphics


@pytest.fixture
def context():
    try:
        context = GlContext()
    except NoGraphics as error:
        pytest.skip(f"no OpenGL here: {error}")
    yield context
    context.close()


def test_context_without_libegl_says_what_to_install(monkeypatch):
    def missing(*args, **kwargs):
        raise OSError("libEGL.so.1: cannot open shared object file")

    monkeypatch.setattr(ctypes, "CDLL", missing)
    with pytest.raises(NoGraphics, match=r"libEGL.so.1 is not installed .*apt install libegl1"):
        GlContext()


def test_context_asked_for_hardware_is_hardware_or_says_why_not(context):
    if context.is_hardware:
        with_hardware = GlContext(hardware=True)
        assert with_hardware.is_hardware
        with_hardware.close()
    else:
        with pytest.raises(NoGraphics, match=r"no hardware OpenGL 4.3 context \(.*software"):
            GlContext(hardware=True)


def test_context_may_be_entered_twice_and_closed_twice(context):
    from OpenGL import GL

    with context.current():
        with context.current():
            version = GL.glGetString(GL.GL_VERSION)
        assert GL.glGetString(GL.GL_VERSION) == version  # still current after the inner one ended
    context.close()
    context.close()


def test_storage_buffer_gives_back_what_was_written(context):
    from hull_server.gl_objects import StorageBuffer

    data = np.arange(1000, dtype=np.uint32)
    with context.current():
        buffer = StorageBuffer(data)
        buffer.write(data[:10] + 7)
        found = buffer.read(np.uint32, 1000)
        with pytest.raises(ValueError, match=r"4004 bytes do not fit a buffer of 4000"):
            buffer.read(np.uint32, 1001)
    assert np.array_equal(found[:10], data[:10] + 7) and np.array_equal(found[10:], data[10:])


def test_shader_that_does_not_compile_is_an_error_with_the_drivers_words(context):
    from hull_server.gl_objects import make_program

    with context.current(), pytest.raises(NoGraphics, match=r"(?s)the driver rejects a compute shader: .*nonsense"):
        make_program(compute="#version 430\nlayout(local_size_x = 1) in;\nvoid main() { nonsense(); }\n")
