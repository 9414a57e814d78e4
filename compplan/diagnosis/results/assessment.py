"""Assessment: what to enter into a controller, how accurate the robot is before and after, what comes next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from compplan.diagnosis.results.accuracy import (
    Accuracy,
    Learning,
    WorstPose,
    draw_learning,
    list_worst,
    measure_accuracy,
)
from compplan.diagnosis.results.calibration import Correction, Pose, list_corrections, list_frames

if TYPE_CHECKING:
    from compplan.diagnosis.results.result import Diagnosis


@dataclass(frozen=True, eq=False)
class Assessment:
    """What a diagnosis is worth to a calibration engineer.

    Attributes:
        corrections: Zeros, lengths, tool and base to enter, with intervals.
        frames: Tool and registered frames as controllers take them.
        accuracy: Pose accuracy "before" and, held out, "after".
        learning: Held-out error over the number of poses, or None.
        worst: Poses that are predicted worst.
    """

    corrections: tuple[Correction, ...]
    frames: tuple[Pose, ...]
    accuracy: dict[str, Accuracy]
    learning: Learning | None
    worst: tuple[WorstPose, ...]

    def to_json(self) -> dict[str, Any]:
        """Return what diagnosis.json holds under `for_controllers` and `accuracy`."""
        return {
            "for_controllers": {
                "corrections": [correction.to_json() for correction in self.corrections],
                "frames": [frame.to_json() for frame in self.frames],
            },
            "accuracy": {
                **{name: accuracy.to_json() for name, accuracy in self.accuracy.items()},
                "learning": None if self.learning is None else self.learning.to_json(),
                "worst_poses": [pose.to_json() for pose in self.worst],
            },
        }


def assess_diagnosis(diagnosis: Diagnosis) -> Assessment:
    """Assess the delivered robot of a diagnosis.

    Args:
        diagnosis: The diagnosis.
    """
    return Assessment(
        list_corrections(diagnosis), list_frames(diagnosis), measure_accuracy(diagnosis), draw_learning(diagnosis),
        list_worst(diagnosis),
    )  # fmt: skip
