"""Whether this machine has OpenGL, for the tests that need it."""

import pytest

from hull_server.opengl.egl import GlContext, NoGraphics

try:
    GlContext().close()
    NO_GL = ""
except NoGraphics as error:
    NO_GL = str(error)
needs_gl = pytest.mark.skipif(bool(NO_GL), reason=f"no OpenGL here: {NO_GL}")
