"""Learned inverse kinematics.

*The network of the paper*: 18 inputs (object position, its change, previous joint changes), 50 hidden units, 12 outputs (joint
changes), fitted to 500 patterns of the four-finger hand that moves a ball along y and z in a sinusoidal way. Held-out patterns
are those of the same path that were not used, and of a path with other amplitudes and frequencies. Errors are RMS errors
divided by the RMS of the joint changes.

*Start values*: the numeric inverse kinematics of one finger starts from the neutral posture, or from the prediction of an
ensemble of three networks fitted to 2000 random postures of that finger. 500 other reachable places. An iteration is one
evaluation of tip and Jacobian. A failure is a place not reached to 1 µm. Times are processor time of a solution, with the
prediction. Starting from the previous posture, as on a path, needs no learning: the last column has the iterations if the
start is 0.05 rad away in each joint.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks import report_page
from graspforce import Hand
from graspforce.core.arrays import Array
from graspforce.geometry import Sphere
from graspforce.grasp.body import Body
from graspforce.grasp.search import find_grasp
from graspforce.hand.kinematics import inverse_kinematics as numeric
from graspforce.learning.inverse_kinematics import finger_patterns, fit_finger_start, fit_network
from graspforce.view.figures import BLUE, GREEN, RED, save_figures

TITLE = "Inverse kinematics"
HANDS = {
    "four_finger": "finger_1",
    "allegro_right": "index",
    "leap_right": "index",
    "dlr_hit2": "index",
    "shadow_right": "first",
}
_PLACES = 500
_SIZES = (25, 50, 100, 200, 350, 500)
PATTERNS = 500
STEP = 0.01  # s


def run(_records: Path, pictures: Path) -> dict[str, Any]:
    """Fit the networks, and count iterations.

    Args:
        pictures: folder of the pictures.
    """
    curve = _paper_network()
    save_figures({"learning_curve": _plot(curve)}, pictures)
    return {"curve": curve, "starts": [_count(name, finger) for name, finger in HANDS.items()]}


def carry_patterns(amplitude: float, frequencies: tuple[float, float], count: int) -> tuple[Array, Array]:
    """Return inputs (N, 18) and outputs (N, 12) of a motion of a held ball along y and z.

    Args:
        amplitude: of both directions, m.
        frequencies: of y and z, Hz.
        count: number N of patterns, 10 ms apart.
    """
    hand = Hand.load("four_finger")
    grasp = find_grasp(hand, Body.solid(Sphere(0.03), 0.05), tuple(finger.name for finger in hand.fingers))
    q, p = grasp.q, grasp.p_HO
    places, postures = [p], [q]
    for k in range(1, count + 2):
        t = k * STEP
        shift = amplitude * np.array([0.0, np.sin(2 * np.pi * frequencies[0] * t), np.sin(2 * np.pi * frequencies[1] * t)])
        q = hand.grasp_posture(grasp.fingers, grasp.contacts, p + shift, grasp.R_HO, q)
        places.append(p + shift)
        postures.append(q)
    u, theta = np.array(places), np.array(postures)
    du, dtheta = np.diff(u, axis=0), np.diff(theta, axis=0)
    return np.hstack([u[1:-1], du[1:], dtheta[:-1]]), dtheta[1:]


def _paper_network() -> list[dict[str, Any]]:
    """Return the errors by number of patterns."""
    x, y = carry_patterns(0.004, (0.5, 0.8), 2 * PATTERNS)
    other_x, other_y = carry_patterns(0.003, (0.7, 0.45), PATTERNS)
    order = np.random.default_rng(0).permutation(len(x))
    train, test = order[:PATTERNS], order[PATTERNS:]

    def error(network: Any, inputs: Array, outputs: Array) -> float:
        return float(np.sqrt(np.square(network.predict(inputs) - outputs).mean() / np.square(outputs).mean()))

    rows = []
    for size in _SIZES:
        network = fit_network(x[train[:size]], y[train[:size]])
        errors = error(network, x[train[:size]], y[train[:size]]), error(network, x[test], y[test])
        rows.append({"size": size, "train": errors[0], "test": errors[1], "other": error(network, other_x, other_y)})
    ensemble = [fit_network(x[train], y[train], seed=k) for k in range(5)]
    mean = np.mean([each.predict(other_x) for each in ensemble], axis=0)
    inside = np.mean([each.predict(x[test]) for each in ensemble], axis=0)
    scale, test_scale = np.square(other_y).mean(), np.square(y[test]).mean()
    rows.append(
        {
            "size": -PATTERNS,  # of the ensemble
            "train": None,
            "test": float(np.sqrt(np.square(inside - y[test]).mean() / test_scale)),
            "other": float(np.sqrt(np.square(mean - other_y).mean() / scale)),
        }
    )
    return rows


def _count(hand_name: str, finger: str) -> dict[str, Any]:
    """Return iterations, failures and times from different starts."""
    hand = Hand.load(hand_name)
    start = fit_finger_start(hand, finger)
    places, _ = finger_patterns(hand, finger, _PLACES, np.random.default_rng(1000))
    joints, frame, neutral = list(start.joints), [hand.frame_id(finger)], np.array(hand.neutral)
    rng, counts = np.random.default_rng(0), [0]

    def tip(q_finger: Array) -> tuple[Array, Array]:
        counts[0] += 1
        q = neutral.copy()
        q[joints] = q_finger
        p, J = hand.model.frame_jacobians(q[None], frame)
        return p[0, 0], J[0, 0, :3, joints].T

    def measure(first: Any) -> dict[str, float]:
        iterations, failures, times = [], 0, []
        for p in places:
            counts[0] = 0
            begin = time.process_time_ns()
            result = numeric.solve(tip, p, start.lower, start.upper, [first(p)])
            times.append(1e-3 * (time.process_time_ns() - begin))
            iterations.append(counts[0])
            failures += int(result.distance > numeric.REACH_TOLERANCE)
        return {"iterations": float(np.mean(iterations)), "failures": failures, "time": float(np.mean(times))}

    near = {p.tobytes(): numeric.solve(tip, p, start.lower, start.upper, [start.predict(p)]).q for p in places}
    error = np.sqrt(np.mean([np.square(start.predict(p) - near[p.tobytes()]).mean() for p in places]))
    return {
        "hand": hand_name,
        "finger": finger,
        "joints": len(joints),
        "error": float(np.degrees(error)),
        "neutral": measure(lambda p: neutral[joints]),
        "learned": measure(start.predict),
        "near": measure(lambda p: near[p.tobytes()] + 0.05 * rng.choice([-1.0, 1.0], len(joints))),
    }


def _plot(rows: list[dict[str, Any]]) -> Figure:
    """Return the learning curve."""
    figure = Figure(figsize=(7, 4.0), layout="constrained")
    panel = figure.subplots()
    own = [each for each in rows if each["size"] > 0]
    for name, label, colour in (("train", "patterns used", BLUE), ("test", "same path", GREEN), ("other", "other path", RED)):
        panel.plot([each["size"] for each in own], [100 * each[name] for each in own], "o-", color=colour, label=label)
    panel.set_yscale("log")
    panel.set_yticks([], minor=True)
    panel.set_yticks([0.1, 0.2, 0.5, 1.0, 2.0, 5.0], ["0.1", "0.2", "0.5", "1", "2", "5"])
    panel.set_xlabel("number of patterns")
    panel.set_ylabel("RMS error (% of the joint changes)")
    panel.grid(alpha=0.25)
    panel.legend(frameon=False)
    figure.suptitle("Network with 18 inputs, 50 hidden units and 12 outputs")
    return figure


def page(result: dict[str, Any]) -> str:
    """Return tables and picture.

    Args:
        result: of `run`.
    """
    curve = [
        (
            f"{each['size']}" if each["size"] > 0 else f"{-each['size']}, mean of 5",
            *("–" if each[name] is None else f"{100 * each[name]:.2f} %" for name in ("train", "test", "other")),
        )
        for each in result["curve"]
    ]
    rows = []
    for each in result["starts"]:
        a, b = each["neutral"], each["learned"]
        saved = 1.0 - b["iterations"] / a["iterations"]
        rows.append(
            (
                f"{each['hand']}, {each['finger']}",
                str(each["joints"]),
                f"{each['error']:.1f}°",
                f"{a['iterations']:.1f}",
                f"{b['iterations']:.1f}",
                f"{100 * saved:.0f} %",
                f"{a['failures']} / {b['failures']}",
                f"{a['time']:.0f} / {b['time']:.0f}",
                f"{each['near']['iterations']:.1f}",
            )
        )
    head = (
        "finger", "joints", "prediction error", "iterations, neutral", "iterations, learned", "fewer", "failures",
        "µs, neutral / learned", "iterations, near start",
    )  # fmt: skip
    first = report_page.table(("patterns", "used", "same path", "other path"), curve)
    return f"{first}\n\n![learning curve](learning/learning_curve.png)\n\n{report_page.table(head, rows)}"
