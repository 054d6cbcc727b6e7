"""Films of trials side by side, and strips of their frames; no display is needed."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from robustopt.config import Config
from robustopt.errors import SimulationFailed
from robustopt.simulation.execute import prepare
from robustopt.simulation.pictures import add_scenery, view_of
from robustopt.simulation.trace import Trace
from robustopt.solvers import Plan

Image = NDArray[np.uint8]

FRAMES_PER_SECOND = 30
WIDTH, HEIGHT = 480, 360
STRIP = 6
"""Number of frames in a strip."""


def film(plan: Plan, traces: Sequence[Trace], config: Config | None = None, seed: int | None = None) -> list[Image]:
    """Draw trials side by side.

    Args:
        plan: the plan.
        traces: its trials over time.
        config: configuration of the trials in place of that of the plan.
        seed: seed of the trials, in place of that of the configuration.

    Returns:
        Frames, (HEIGHT, WIDTH * len(traces), 3) each.

    Raises:
        SimulationFailed: MuJoCo cannot draw here.
    """
    job = prepare(plan, config, seed)
    columns = []
    for trace in traces:
        spec = job.world.spec(job.parameters(trace.outcome.trial))
        add_scenery(spec, job.config, job.world.robot)
        model = spec.compile()
        q = trace.qpos[::100][:, job.world.layout(model).joints]
        columns.append(_frames(model, view_of(job.config, job.world.robot, q), trace))
    return [np.concatenate(row, axis=1) for row in zip(*columns, strict=True)]


def write_film(frames: Sequence[Image], folder: Path) -> list[Path]:
    """Write a film, as MP4 if the system has ffmpeg, else as animated WebP, and a strip of frames.

    Args:
        frames: the film.
        folder: folder of the files; made if there is none.

    Returns:
        The files.
    """
    from PIL import Image as Picture

    folder.mkdir(parents=True, exist_ok=True)
    strip = folder / "trials_strip.png"
    chosen = np.linspace(0, len(frames) - 1, STRIP).round().astype(int)
    Picture.fromarray(np.concatenate([frames[k] for k in chosen], axis=0)).save(strip)
    return [_write_mp4(frames, folder / "trials.mp4") or _write_webp(frames, folder / "trials.webp"), strip]


def _write_mp4(frames: Sequence[Image], path: Path) -> Path | None:
    """Write the film as MP4; return None if there is no ffmpeg that can."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        return None
    height, width, _ = frames[0].shape
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(FRAMES_PER_SECOND), "-i", "-"]
    command = [ffmpeg, "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", str(path)]
    try:
        subprocess.run(command, input=b"".join(frame.tobytes() for frame in frames), capture_output=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        path.unlink(missing_ok=True)
        return None
    return path


def _write_webp(frames: Sequence[Image], path: Path) -> Path:
    from PIL import Image as Picture

    first, *others = [Picture.fromarray(frame) for frame in frames]
    first.save(path, save_all=True, append_images=others, duration=round(1000 / FRAMES_PER_SECOND), loop=0, quality=70)
    return path


def _frames(model: mujoco.MjModel, camera: mujoco.MjvCamera, trace: Trace) -> list[Image]:
    model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
    model.vis.headlight.ambient[:] = 0.45
    data = mujoco.MjData(model)
    every = max(1, round(1 / FRAMES_PER_SECOND / model.opt.timestep))
    try:
        renderer = mujoco.Renderer(model, HEIGHT, WIDTH)
    except Exception as error:
        message = f"No pictures can be drawn: {error}. Without a display, set MUJOCO_GL to egl or osmesa."
        raise SimulationFailed(message) from error
    frames = []
    with renderer:
        for qpos in trace.qpos[::every]:
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera)
            frames.append(renderer.render().copy())
    return frames
