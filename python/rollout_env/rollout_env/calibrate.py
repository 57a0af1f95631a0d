"""σ of the actuation axis, from open-loop tracking errors as LIBERO-CTRL's.

A demonstration's actions are executed again, distorted along one parameter alone. LIBERO-CTRL's σ
is the value, divided by 8, at which the end-effector's largest deviation is 20 mm; here as the
median over the demonstrations.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .description import DIMENSIONS, Failed, Simulator, Unusable

#: Deviation at the radius, mm.
TARGET_MM, RADIUS = 20.0, 8.0
#: Parameters with the largest value that is tried, in the unit of the manifest's columns.
PARAMETERS = {
    "gain_log2": 2.0,
    "bias_frac": 2.0,
    "misalign_deg": 90.0,
    "lag_tau": 20.0,
    "noise_frac": 4.0,
}
#: Relative accuracy of σ; seed of the drawn elements.
TOLERANCE, SEED = 0.02, 0


def calibrate(
    simulator: Simulator, demonstrations: dict[str, np.ndarray], position: str, mm: float
) -> dict[str, Any]:
    """Returns σ by parameter. Demonstrations are named TASK@SEED; `mm` converts `position`."""
    about = simulator.description
    if not {"x", "y", "z"} & set(about.action):
        raise Unusable("the actions have no translation: name their numbers with --action")
    if position not in about.state:
        raise Unusable(
            f"there is no reading `{position}`, but {', '.join(about.state)}: name the "
            "end-effector's position with --position"
        )
    arm = _columns(about.action)
    actions = np.concatenate(list(demonstrations.values()))
    # Of the length of the translation, and of the rotation, as in LIBERO-CTRL.
    rms = [float(np.sqrt(np.mean(np.sum(actions[:, part] ** 2, axis=1)))) for part in arm]

    def path(name: str, distortion: dict[str, float]) -> np.ndarray:
        task, _, seed = name.rpartition("@")
        simulator.reset(task, int(seed), {})
        distort = _distortion(distortion, arm, rms)
        positions = []
        for action in demonstrations[name]:
            step = simulator.step(distort(action))
            positions.append(simulator.observe([]).state[position])
            if step.ended:
                break
        return np.array(positions)

    nominal = {name: path(name, {}) for name in demonstrations}
    for name, positions in nominal.items():
        if not np.array_equal(positions, path(name, {})):
            raise Failed(
                f"{name} differs when it is repeated: make the environment deterministic, see check"
            )

    def deviation(parameter: str, value: float) -> float:
        each = []
        for name, positions in nominal.items():
            distorted = path(name, {parameter: value})
            steps = min(len(positions), len(distorted))
            each.append(np.linalg.norm(distorted[:steps] - positions[:steps], axis=1).max() * mm)
        return float(np.median(each))

    units = {}
    for parameter, largest in PARAMETERS.items():
        if parameter == "misalign_deg" and min(len(part) for part in arm if part) < 2:
            continue
        # Nearly proportional, so that a few steps suffice; halves the interval where it is not.
        low, high, value = 0.0, largest, largest / 8
        while high - low > TOLERANCE * high:
            reached = deviation(parameter, value)
            if abs(reached / TARGET_MM - 1) < TOLERANCE:
                break
            low, high = (value, high) if reached < TARGET_MM else (low, value)
            scaled = value * TARGET_MM / max(reached, 1e-9)
            value = scaled if low < scaled < high else (low + high) / 2
        if value > largest * (1 - TOLERANCE):
            raise Failed(
                f"{parameter} of {largest} deviates less than {TARGET_MM} mm: use longer "
                "demonstrations, or correct --mm"
            )
        units[parameter] = float(f"{value / RADIUS:.4g}")
    return {
        "unit": units,
        "demo_action_rms": [round(value, 3) for value in rms],
        "target_mm": TARGET_MM,
        "radius": RADIUS,
        "demonstrations": {name: len(actions) for name, actions in demonstrations.items()},
        "simulator": about.name,
        "packages": about.packages,
    }


def _columns(action: list[str]) -> tuple[list[int], list[int]]:
    """Returns the columns of translation and of rotation."""
    known = [action.index(word) if word in action else -1 for word in DIMENSIONS[:6]]
    translation, rotation = known[:3], known[3:]
    return [one for one in translation if one >= 0], [one for one in rotation if one >= 0]


def _distortion(
    values: dict[str, float], arm: tuple[list[int], list[int]], rms: list[float]
) -> Any:
    """Returns the actuation axis of `docs/PROTOCOL.md` as a function of an action."""
    rng = np.random.default_rng(SEED)
    direction, axis = rng.standard_normal(6), rng.standard_normal(3)
    direction, axis = direction / np.linalg.norm(direction), axis / np.linalg.norm(axis)
    turn = _rotation(axis, np.radians(values.get("misalign_deg", 0.0)))
    share = 1.0 / (1.0 + abs(values.get("lag_tau", 0.0)))
    lagged = np.zeros(6)

    def distort(action: np.ndarray) -> np.ndarray:
        output = np.array(action, dtype=np.float64)
        noise = rng.standard_normal(6)
        for group, (columns, scale) in enumerate(zip(arm, rms)):
            part = slice(3 * group, 3 * group + 3)
            arm_action = np.zeros(3)
            arm_action[: len(columns)] = output[columns]
            wanted = turn @ (arm_action * 2.0 ** values.get("gain_log2", 0.0))
            wanted = wanted + values.get("bias_frac", 0.0) * scale * direction[part]
            lagged[part] = share * wanted + (1 - share) * lagged[part]
            noisy = lagged[part] + abs(values.get("noise_frac", 0.0)) * scale * noise[part]
            output[columns] = noisy[: len(columns)]
        return np.clip(output, -1, 1)

    return distort


def _rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
