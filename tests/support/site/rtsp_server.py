"""A real RTSP server for tests: GStreamer's, as Debian packages it, run by the system's Python.

Each picture carries the moment at which it was made, so that whoever receives it knows its age:
64 blocks, white where the bit of Unix time in microseconds is set. Commands on standard input:
`freeze` and `thaw` stop and start the pictures while the connection stays.

Run as: python3 rtsp_server.py PORT CODEC
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
import sys
import threading
import time

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

WIDTH, HEIGHT, RATE = 320, 240, 15
BLOCK = 16
ENCODERS = {
    "h264": "x264enc tune=zerolatency speed-preset=ultrafast key-int-max=15 bitrate=2000 "
    "! rtph264pay name=pay0 pt=96 config-interval=1",
    "jpeg": "jpegenc quality=90 ! rtpjpegpay name=pay0 pt=26",
}


def picture(number: int, micros: int) -> bytes:
    """A grey picture, I420, with the time in its top half."""
    rows = []
    per_row = WIDTH // BLOCK
    for start in range(0, 64, per_row):
        bits = [(micros >> bit) & 1 for bit in range(start, min(start + per_row, 64))]
        line = b"".join(bytes([235 if bit else 16]) * BLOCK for bit in bits)
        rows.append(line.ljust(WIDTH, b"\x80") * BLOCK)
    luma = b"".join(rows)
    shade = bytes([40 + number % 160])
    luma += shade * (WIDTH * HEIGHT - len(luma))
    return luma + b"\x80" * (WIDTH * HEIGHT // 2)


class Factory(GstRtspServer.RTSPMediaFactory):
    """Live pictures from this process."""

    def __init__(self, codec: str) -> None:
        super().__init__()
        self.is_frozen = threading.Event()
        caps = f"video/x-raw,format=I420,width={WIDTH},height={HEIGHT},framerate={RATE}/1"
        self.set_launch(
            f"( appsrc name=source is-live=true do-timestamp=true format=time caps={caps} "
            f"! {ENCODERS[codec]} )"
        )
        self.set_shared(True)

    def feed(self, media: GstRtspServer.RTSPMedia) -> None:
        source = media.get_element().get_child_by_name("source")
        threading.Thread(target=self._feed, args=(source,), daemon=True).start()

    def _feed(self, source: Gst.Element) -> None:
        number = 0
        due_s = time.monotonic()
        while True:
            due_s += 1 / RATE
            time.sleep(max(0.0, due_s - time.monotonic()))
            if self.is_frozen.is_set():
                continue
            data = picture(number, time.time_ns() // 1000)
            if source.emit("push-buffer", Gst.Buffer.new_wrapped(data)) != Gst.FlowReturn.OK:
                return
            number += 1


def main() -> None:
    port, codec = sys.argv[1:]
    Gst.init(None)
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(port)
    factory = Factory(codec)
    factory.connect("media-configure", lambda f, media: f.feed(media))
    server.get_mount_points().add_factory("/live", factory)
    if not server.attach(None):
        sys.exit(f"port {port} is taken")
    loop = GLib.MainLoop()

    def listen() -> None:
        for line in sys.stdin:
            if line.strip() == "freeze":
                factory.is_frozen.set()
            elif line.strip() == "thaw":
                factory.is_frozen.clear()
        loop.quit()

    threading.Thread(target=listen, daemon=True).start()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    loop.run()


main()
