"""Run as a program: prints, as JSON, the OpenGL that a hull server would find here.

A process of its own, because a broken graphics driver may take the whole process down with it.
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
    """Ask in a process of its own."""
    command = [sys.executable, "-m", __name__]
    try:
        answer = subprocess.run(command, capture_output=True, text=True, timeout=ANSWER_S, check=False)
    except subprocess.TimeoutExpired:
        return GraphicsFacts(f"the graphics driver did not answer within {ANSWER_S:g} s")
    if answer.returncode:
        last = (answer.stderr.strip().splitlines() or ["nothing was said"])[-1]
        return GraphicsFacts(f"the graphics driver ended the process (status {answer.returncode}: {last})")
    return GraphicsFacts(**json.loads(answer.stdout.splitlines()[-1]))


def ask() -> GraphicsFacts:
    """Hardware before software, as the hull server looks for it."""
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
