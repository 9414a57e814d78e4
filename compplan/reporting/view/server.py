"""Show a scene in the browser with viser: solids, lines, sliders, clicks. The data are computed in the scenes."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from compplan.errors import InputError
from compplan.io.palette import NEUTRAL
from compplan.io.quantities import format_length, format_set_length
from compplan.reporting.provenance import GRADE_MEANING
from compplan.reporting.view.scene import (
    ERROR_BAND,
    LAST,
    Lines,
    PlanScene,
    join_rows,
    paint_sizes,
    pick_point,
    read_colour,
)
from compplan.reporting.writers.recording import read_recording
from compplan.robot import Array

HOST = "127.0.0.1"
#: Camera distance, and lateral shift of the view, whose right side the panel covers; in radii of the bounding sphere of
#: the scene.
FRAMED, BESIDE_PANEL = 1.5, 0.3
#: Colour of the force arrow, and of the mark at the tip.
DARK, MARK = np.full((1, 2, 3), 60, np.uint8), (29, 35, 41)
#: Width of the floor and spacing of its lines. [m]
FLOOR, CELL = 6.0, 0.5
#: Frame rate, and update rate of the panel while the arm moves. [1/s]
PICTURES, PANEL = 30.0, 5.0
#: Length of the longest force arrow, as a share of the arm's reach.
FORCE_LENGTH = 0.12


def start_server(folder: Path, port: int) -> PlanViewer:
    """Serve a result folder on loopback; return the viewer, which runs until it is stopped."""
    try:
        import viser
    except ImportError:
        raise InputError("the viewer needs viser, which is not installed; pip install 'compplan[view]'") from None
    recording = read_recording(folder)
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            raise InputError(f"port {port} on {HOST} is taken, name another with --port") from None
    with redirect_stdout(StringIO()):  # suppress its greeting
        server = viser.ViserServer(host=HOST, port=port, verbose=False)
    return PlanViewer(server, PlanScene(recording))


class PlanViewer:
    """Viewer of a plan in the browser; the arm moves along the path at the planned times."""

    def __init__(self, server: Any, scene: PlanScene) -> None:
        self.server, self.facts, self.scene = server, scene.recording.facts, scene
        self.row, self.lock, self.written, self.running = scene.start, threading.RLock(), 0.0, True
        self._add_cell()
        tip = scene.recording.tip
        extent = max(float(np.ptp(tip, axis=0).max()), 0.05)
        greatest = float(np.linalg.norm(scene.recording.force, axis=1).max(initial=0.0))
        self.metres_per_newton = FORCE_LENGTH * max(extent, 1.0) / max(greatest, 1e-9)
        self._build_panel()
        size = 0.012 * extent + 0.001
        self.marker = server.scene.add_icosphere(f"{self.root}/tip", radius=size, color=MARK)
        self.force = self.draw("/force", Lines(np.zeros((1, 2, 3), np.float32), DARK), 3.0)
        self.draw("/wanted", join_rows(tip, np.tile(read_colour(NEUTRAL), (len(tip), 1))), 1.5)
        poses = scene.pose_links(scene.start)
        self.move(poses)
        self.look_at(tip[scene.cut], poses)
        self.redraw()
        server.scene.on_pointer_event("click")(self._click)
        threading.Thread(target=self._run, daemon=True).start()

    def _add_cell(self) -> None:
        """Add the solids of the cell, those of the arm in frames that move with its links."""
        server, ground = self.server, self.facts["ground"]
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.add_grid("/floor", width=FLOOR, height=FLOOR, cell_size=CELL, section_thickness=0.0)
        self.root, self.carried = "/part" if ground else "", np.asarray(np.eye(4))
        self.part = server.scene.add_frame("/part", show_axes=False) if ground else None
        add = server.scene.add_frame
        self.frames = {link: add(f"{self.root}/arm/{link}", show_axes=False) for link in self.facts["links"]}
        for number, solid in enumerate(self.scene.recording.solids):
            name = self.root + (f"/arm/{solid.link}/{number}" if solid.link else f"/cell/{solid.name}")
            *shade, opacity = solid.colour
            server.scene.add_mesh_simple(
                name, solid.vertices.astype(np.float32), solid.faces.astype(np.uint32), flat_shading=True,
                color=tuple(round(255 * value) for value in shade), opacity=None if opacity > 0.99 else opacity,
                side="double", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip

    def move(self, poses: dict[str, Array]) -> None:
        """Move the links; if a positioner carries the part, move the complete scene, so that the ground stays fixed."""
        if self.part is not None:
            self.carried = np.asarray(np.linalg.inv(poses[self.facts["ground"]]))
            self.part.wxyz = Rotation.from_matrix(self.carried[:3, :3]).as_quat(scalar_first=True)
            self.part.position = self.carried[:3, 3]
        turns = Rotation.from_matrix(np.stack([poses[link][:3, :3] for link in self.frames])).as_quat(scalar_first=True)
        for (link, frame), turn in zip(self.frames.items(), turns, strict=True):
            frame.wxyz, frame.position = turn, poses[link][:3, 3]

    def draw(self, name: str, lines: Lines, width: float) -> Any:
        """Draw lines; width in pixels."""
        return self.server.scene.add_line_segments(
            self.root + name, lines.points, lines.colours, thickness=width, thickness_units="screen"
        )

    def see(self, points: Array) -> Array:
        """Transform points from the base frame to the ground frame at the current row. Shape (n, 3). [m]"""
        return np.asarray(points @ self.carried[:3, :3].T + self.carried[:3, 3])

    def look_at(self, points: Array, poses: dict[str, Array]) -> None:
        """Place the camera to show the complete arm and the path, points (n, 3) [m], with the path in front."""
        corners = [poses[solid.link][:3, 3] + solid.vertices @ poses[solid.link][:3, :3].T
                   for solid in self.scene.recording.solids if solid.link in poses]  # fmt: skip
        points, everything = self.see(points), self.see(np.concatenate([*corners, np.zeros((1, 3)), points]))
        low, high = everything.min(axis=0), everything.max(axis=0)
        middle, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
        out = np.append(points.mean(axis=0)[:2] - middle[:2], 0.0)
        out /= max(float(np.linalg.norm(out)), 1e-9)
        aside = out + 0.9 * np.array([out[1], -out[0], 0.0]) + np.array([0.0, 0.0, 0.55])
        aside /= float(np.linalg.norm(aside))
        right = np.cross(-aside, [0.0, 0.0, 1.0])
        middle = middle + BESIDE_PANEL * radius * right / max(float(np.linalg.norm(right)), 1e-9)
        self.near = (1.5 * float(np.ptp(points, axis=0).max()) + 0.05) * aside
        camera = self.server.initial_camera
        camera.position, camera.look_at = middle + FRAMED * radius * aside, middle

    def _build_panel(self) -> None:
        gui, scene, facts = self.server.gui, self.scene, self.facts
        grade = GRADE_MEANING[facts["grade"]]
        gui.add_markdown(f"**{facts['name']}** \n\n{facts['robot']}, robot model {grade}")
        shown = next(way for way in ("uncorrected", ERROR_BAND, "planned") if way in scene.ways)
        self.way = gui.add_dropdown("show the tip", list(scene.ways.values()), initial_value=scene.ways[shown])
        first = int(scene.magnification(shown))
        self.magnify = gui.add_slider("deviation times", min=1, max=500, step=1, initial_value=first)
        self.bar = gui.add_markdown("")
        self.play = gui.add_checkbox("play", initial_value=False)
        self.slider = gui.add_slider(
            "waypoint", min=0, max=len(scene.recording.time) - 1, step=1, initial_value=self.row
        )
        self.speed = gui.add_slider("speed, times real", min=0.1, max=20.0, step=0.1, initial_value=1.0)
        self.worst = gui.add_button("worst place")
        with gui.add_folder("this waypoint"):
            self.text = gui.add_markdown("")
        self.way.on_update(self._choose)
        self.magnify.on_update(lambda _: self.redraw())
        self.slider.on_update(self._slide)
        self.worst.on_click(self._go_to_worst)

    def _choose(self, event: Any) -> None:
        """Change the display mode of the tip, with its magnification."""
        if event.client is not None:
            self.magnify.value = int(self.scene.magnification(self.chosen))
        self.redraw()

    def _go_to_worst(self, event: Any) -> None:
        """Go to the row of the greatest deviation, and move the camera there."""
        row = self.scene.find_worst(self.chosen)
        self._stop_at(row)
        if event.client is not None:
            point = self.see(self.scene.recording.tip[row])
            event.client.camera.position, event.client.camera.look_at = point + 0.6 * self.near, point

    @property
    def chosen(self) -> str:
        """Selected display mode."""
        return next(way for way, name in self.scene.ways.items() if name == self.way.value)

    def redraw(self) -> None:
        """Redraw path, colour legend and current row."""
        with self.lock, self.server.atomic():
            way, magnify = self.chosen, float(self.magnify.value)
            colours = paint_sizes(self.scene.sizes[way], self.scene.top(way) / LAST)
            self.draw("/path", join_rows(self.scene.place(way, magnify), colours), 6.0)
            ends = format_length(self.scene.top(way)), format_set_length(self.scene.recording.tolerance)
            self.bar.content = "Deviation: blue none, dark red {}; tolerance {}".format(*ends)
            self.show_row(self.row)

    def show_row(self, row: int) -> None:
        """Show the arm, the tip and the force at a row."""
        with self.lock:
            self.row = row
            way, magnify = self.chosen, float(self.magnify.value)
            with self.server.atomic():
                self.move(self.scene.pose_links(row))
                tip = self.scene.place(way, magnify, row)
                self.marker.position = tip
                force = self.metres_per_newton * self.scene.recording.force[row]
                self.force.points = np.stack([tip, tip + force]).astype(np.float32)[None]
            if time.monotonic() - self.written > 1.0 / PANEL or not self.play.value:
                self.written = time.monotonic()
                self.text.content = self.scene.tell(row)

    def _slide(self, event: Any) -> None:
        if event.client is not None:  # moved by the user
            self.show_row(int(self.slider.value))

    def _click(self, event: Any) -> None:
        points = self.see(self.scene.place(self.chosen, float(self.magnify.value)))
        self._stop_at(pick_point(points, np.array(event.ray_origin), np.array(event.ray_direction)))

    def _stop_at(self, row: int) -> None:
        """Stop the arm at a row."""
        self.play.value = False
        self.slider.value = row
        self.show_row(row)

    def _run(self) -> None:
        clock, shown, times = 0.0, time.monotonic(), self.scene.recording.time
        while self.running:
            time.sleep(1.0 / PICTURES)
            now = time.monotonic()
            if not self.play.value:
                clock, shown = float(times[self.row]), now
                continue
            clock += (now - shown) * float(self.speed.value)
            shown = now
            if clock > times[-1]:
                clock = 0.0
            before = self.written
            self.show_row(int(np.searchsorted(times, clock)))
            if self.written != before:
                self.slider.value = self.row

    def stop(self) -> None:
        """End the motion and close the server, without its messages."""
        self.running = False
        with redirect_stdout(StringIO()):
            self.server.stop()
