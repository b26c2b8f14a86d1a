"""What a browser is given beside viser's client: the page's title, and thrift where there is no GPU.

Drawn by the processor (SwiftShader, llvmpipe), a frame of 1280 x 860 takes 20 to 50 ms of a core which the graph often
needs on the same machine, and viser draws as often as the screen can while anything moves. There, and only there, the
canvas is drawn without antialiasing and at every second refresh of the screen.
"""

from __future__ import annotations

from websockets.datastructures import Headers
from websockets.http11 import Response

FULL_FRAME_MS = 25
"""Between two frames without a GPU: shorter than two refreshes of a 60 Hz screen and longer than one."""
SCRIPT = """<script>
document.title = "sagoma";
(() => {
    const gl = document.createElement("canvas").getContext("webgl2");
    const info = gl && gl.getExtension("WEBGL_debug_renderer_info");
    const renderer = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
    if (!/swiftshader|llvmpipe|software|basic render/i.test(renderer)) return;

    const getContext = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, attributes) {
        const plain = kind.startsWith("webgl") ? {...attributes, antialias: false} : attributes;
        return getContext.call(this, kind, plain);
    };

    const request = window.requestAnimationFrame.bind(window), cancel = window.cancelAnimationFrame.bind(window);
    const waiting = new Map();
    let drawn = -Infinity, number = 0;
    window.requestAnimationFrame = callback => {
        const id = ++number;
        const refreshed = now => {
            if (now !== drawn && now - drawn < FULL_FRAME_MS) {
                waiting.set(id, request(refreshed));
                return;
            }
            drawn = now;
            waiting.delete(id);
            callback(now);
        };
        waiting.set(id, request(refreshed));
        return id;
    };
    window.cancelAnimationFrame = id => {
        cancel(waiting.get(id));
        waiting.delete(id);
    };
})();
</script>""".replace("FULL_FRAME_MS", str(FULL_FRAME_MS))
HEAD = b"<head>"


def with_script(page: Response) -> Response:
    """Return viser's page, uncompressed, with our script before its own; RuntimeError when it is another page."""
    before, head, after = page.body.partition(HEAD)
    if not head:
        raise RuntimeError("this version of viser serves another page: our script has no place in it")
    body = before + head + SCRIPT.encode() + after
    headers = Headers(page.headers)
    del headers["Content-Length"]
    headers["Content-Length"] = str(len(body))
    return Response(page.status_code, page.reason_phrase, headers, body)
