"""What `compplan view` costs: server work and bytes a picture, start, memory, pictures a second in headless Chromium.

    python -m benchmarks.viewer [--folder OUT ...] [--no-browser]

Without a folder it plans the circle of 2,000 waypoints and the cone of 50,000, each measured in a process of its own.
Server work is processor time of the thread that shows a row, messages and bytes are what goes to one browser for
it. Pictures a second are counted by requestAnimationFrame while the arm moves; where Chromium draws in software, all
cores are its graphics card, and the last column, the same page with everything but one ball taken away, is the most
that it can do.
"""

from __future__ import annotations

import argparse
import json
import resource
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

JOBS = ("circle_500mm", "isf_cone_50k")
PATHS = Path(__file__).parents[1] / "paths"
#: Rows that are timed, and how long pictures are counted. [s]
ROWS, SECONDS = 300, 8.0


def measure(folder: Path, browser: bool) -> dict[str, float]:
    """Measure the viewer on one plan."""
    clock = time.perf_counter()
    from compplan.reporting.view.server import start_server

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    viewer = start_server(folder, port)
    count = viewer.scene.count
    found = {"rows": count, "rows_drawn": len(viewer.scene.rows), "start_s": time.perf_counter() - clock}
    found["memory_MB"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    rows = np.linspace(0, count - 1, ROWS).astype(int).tolist()
    found |= {f"frame_{name}": value for name, value in time_frames(viewer, rows).items()}
    clock = time.thread_time()
    viewer.redraw()
    found["redraw_ms"] = 1e3 * (time.thread_time() - clock)
    clock = time.thread_time()
    viewer.scene.pick(viewer.scene.recording.tip.mean(axis=0) + 1.0, -np.ones(3), "planned", 1.0)
    found["pick_ms"] = 1e3 * (time.thread_time() - clock)
    if browser:
        found |= count_pictures(viewer, port)
    viewer.stop()
    return found


def time_frames(viewer: Any, rows: list[int]) -> dict[str, float]:
    """Time rows that are shown as while the arm moves, and weigh what is sent for them."""
    from viewer_traffic import record_traffic

    times = []
    with record_traffic() as sent:
        for row in rows:
            clock = time.thread_time()
            viewer.show_row(row)
            times.append(1e3 * (time.thread_time() - clock))
    low, high = np.percentile(times, [50, 95])
    return {"p50_ms": low, "p95_ms": high, "messages": len(sent) / len(rows), "bytes": sum(sent) / len(rows)}


def count_pictures(viewer: Any, port: int) -> dict[str, float]:
    """Count the pictures that Chromium draws while the arm moves, and then with nothing but a ball."""
    from browser import browse

    with browse() as page:
        page.open(f"http://127.0.0.1:{port}", 1300, 900)
        page.wait("document.querySelector('canvas') !== null && document.body.innerText.includes('magnify')")
        page.run("window.drawn = 0; (function draw() { window.drawn += 1; requestAnimationFrame(draw); })()")
        viewer.play.value = True
        whole = _rate(page)
        for name in ("/floor", "/path", "/wanted", "/cell"):
            viewer.server.scene.remove_by_name(name)
        for frame in viewer.stage.frames.values():
            frame.visible = False
        ball = _rate(page)
        return {"pictures_per_s": whole, "ball_alone_per_s": ball, "complaints": len(page.complaints)}


def _rate(page: Any) -> float:
    time.sleep(3.0)
    before, clock = page.run("window.drawn"), time.monotonic()
    time.sleep(SECONDS)
    after = page.run("window.drawn")
    return float(after - before) / (time.monotonic() - clock)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, action="append", default=[])
    parser.add_argument("--no-browser", action="store_true")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one is not None:
        print(json.dumps(measure(asked.one, not asked.no_browser)))
        return
    with tempfile.TemporaryDirectory() as home:
        folders = asked.folder or [plan(name, Path(home) / name) for name in JOBS]
        told = [run_apart(folder, asked.no_browser) for folder in folders]
    for name in told[0]:
        print(f"{name:18}" + "".join(f"{entry[name]:12.5g}" for entry in told))


def plan(name: str, folder: Path) -> Path:
    """Plan a shipped job."""
    command = [sys.executable, "-m", "compplan", "plan", str(PATHS / f"{name}.toml"), "--out", str(folder)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return folder


def run_apart(folder: Path, blind: bool) -> dict[str, float]:
    """Measure in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.viewer", "--one", str(folder)] + ["--no-browser"] * blind
    answer = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return dict(json.loads(answer.splitlines()[-1]))


if __name__ == "__main__":
    main()
