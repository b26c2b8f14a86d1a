"""Finds the OpenGL that a hull server would use here; run as a program, prints it as JSON.

It runs in its own process, because a broken graphics driver may crash it.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
from dataclasses import asdict

from hull_server.opengl.egl import GlContext, NoGraphics

from ..facts import GraphicsFacts

ANSWER_S = 30.0
GL_VERSION = 0x1F02


def collect_graphics() -> GraphicsFacts:
    """Run this module as a program and read its answer."""
    command = [sys.executable, "-m", __name__]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=ANSWER_S, check=False)
    except subprocess.TimeoutExpired:
        return GraphicsFacts(f"the graphics driver did not answer within {ANSWER_S:g} s")
    if answer.returncode:
        last = (answer.stderr.strip().splitlines() or ["no message"])[-1]
        return GraphicsFacts(f"the graphics driver ended the process (status {answer.returncode}: {last})")
    return GraphicsFacts(**json.loads(answer.stdout.splitlines()[-1]))


def ask() -> GraphicsFacts:
    """Look for a hardware device, then for a software renderer, as the hull server does."""
    try:
        context = GlContext()
    except NoGraphics as error:
        return GraphicsFacts(str(error))
    try:
        with context.current():
            return GraphicsFacts("", context.renderer, _version(), context.is_hardware)
    finally:
        context.close()


def _version() -> str:
    library = ctypes.CDLL("libOpenGL.so.0")
    library.glGetString.restype = ctypes.c_char_p
    return (library.glGetString(GL_VERSION) or b"").decode(errors="replace")


if __name__ == "__main__":
    print(json.dumps(asdict(ask())))
