"""The truth machines of the benchmark: the DMU 50, a mill with a trunnion, a robot, a stage."""

from __future__ import annotations

import numpy as np

from tests.scored_cases.plan import TruthAxis
from tests.truth import few_axes
from tests.truth.any_chain import Chain, Link
from tests.truth.any_machine import Dmu50, TruthMachine
from tests.truth.reference import about, translation

HERE = np.eye(4)


def machines() -> dict[str, TruthMachine]:
    """Return all truth machines by name."""
    return {machine.name: machine for machine in (Dmu50(), trunnion(), robot(), stage())}


def trunnion() -> Chain:
    """Return the machine of `urdf/trunnion_ac.yaml`: X, Z carry the tool; Y carries A, 60 mm above the table's surface; A carries C.

    A positive command moves or turns the workpiece along −y, about −x and about −z.
    """
    x, y, z = np.eye(3)
    tool = Link("X", HERE, True, x, 300.0), Link("Z", HERE, True, z, -450.0)
    work = (
        Link("Y", HERE, True, -y, 250.0),
        Link("A", translation(0, 0, 60), False, -x),
        Link("C", translation(0, 0, -60), False, -z),
    )
    return Chain(
        name="trunnion",
        bundled="trunnion_ac",
        axes=(
            TruthAxis("X", True, 0.0, 600.0, "tool"),
            TruthAxis("Y", True, 0.0, 500.0, "work"),
            TruthAxis("Z", True, -450.0, 0.0, "tool"),
            TruthAxis("A", False, -120.0, 30.0, "work"),
            TruthAxis("C", False, 0.0, 360.0, "work", endless=True),
        ),
        sides={"tool": (tool, HERE), "work": (work, HERE)},
        targets={
            "K": ("tool", (-90.0, 80.0, 150.0)),
            "P": ("tool", (40.0, -60.0, 20.0)),
            "Q": ("tool", (100.0, 50.0, 120.0)),
            "T": ("work", (-80.0, 120.0, 160.0)),
            "U": ("work", (-110.0, -150.0, 40.0)),
            "V": ("work", (130.0, 70.0, 110.0)),
        },
        home=(300.0, 250.0, -225.0, 0.0, 0.0),
        squareness=("E_C0Y", "E_A0Z", "E_B0Z"),
        locations=("E_Y0A", "E_Z0A", "E_B0A", "E_C0A", "E_X0C", "E_Y0C", "E_A0C", "E_B0C"),
        drooping=("A",),
        sensors=("X", "Y", "Z", "bed"),
        has_spindle=True,
    )


def robot() -> Chain:
    """Return the arm of `tests.truth.few_axes`: joints alternate about z and y, each 50 mm in front of and 300 mm above the previous.

    The error frame of a joint about y has its z along y.
    """
    step, lying, upright = translation(50, 0, 300), about(0, -np.pi / 2), about(0, np.pi / 2)
    before = [step if i == 1 else step @ lying if i % 2 == 0 else upright @ step for i in range(1, 7)]
    links = tuple(Link(f"J{i}", frame, False, np.array([0.0, 0.0, 1.0])) for i, frame in enumerate(before, start=1))
    return Chain(
        name="robot",
        axes=tuple(TruthAxis(f"J{i}", False, -100.0, 100.0, "tool") for i in range(1, 7)),
        sides={"tool": (links, upright)},
        targets={
            "K": ("tool", (80.0, 0.0, 120.0)),
            "P": ("tool", (-60.0, 90.0, 60.0)),
            "Q": ("tool", (-40.0, -80.0, 150.0)),
        },
        home=(0.0,) * 6,
        locations=tuple(f"E_{letter}0J{i}" for i in range(1, 7) for letter in "XYAB"),
        sigma_mm=10e-3,
        stops=9,
        poses=250,
        write=lambda folder: few_axes.write_robot(folder, 6, 100.0),
    )


def stage() -> Chain:
    """Return a slide of 500 mm with two targets, and two on its bed, all at known positions."""
    return Chain(
        name="stage",
        axes=(TruthAxis("X", True, 0.0, 500.0, "tool"),),
        sides={"tool": ((Link("X", HERE, True, np.array([1.0, 0.0, 0.0])),), HERE), "work": ((), HERE)},
        targets={
            "K": ("tool", (60.0, 40.0, 80.0)),
            "P": ("tool", (-50.0, -60.0, 160.0)),
            "T": ("work", (-100.0, 250.0, 40.0)),
            "U": ("work", (400.0, 200.0, 90.0)),
        },
        home=(0.0,),
        rounds=5,
        stops=26,
        poses=60,
        sensors=("X", "bed"),
        places_known=True,
        write=few_axes.write_stage,
    )
