"""Force problems in other units."""

from __future__ import annotations

from graspforce import ForceProblem


def in_other_units(problem: ForceProblem, force: float, length: float) -> ForceProblem:
    """Return the problem with forces and lengths multiplied by factors: a larger factor is a smaller unit."""
    record = problem.to_dict()
    for contact in record["contacts"]:
        contact["position"] = [length * x for x in contact["position"]]
        contact["torsional_friction"] = length * (contact.get("torsional_friction") or 0.0)
        contact["min_normal"] = force * (contact.get("min_normal") or 0.0)
        contact["max_normal"] = None if contact.get("max_normal") is None else force * contact["max_normal"]
    record["wrench"] = [(force if i < 3 else force * length) * x for i, x in enumerate(record["wrench"])]
    for name in ("bias_torque", "torque_lower", "torque_upper") if "hand" in record else ():
        record["hand"][name] = [None if x is None else force * length * x for x in record["hand"][name]]
    if "hand" in record:
        moments = [model == "soft" for model in (contact["model"] for contact in record["contacts"])]
        sizes = [{"frictionless": 1, "point": 3, "soft": 4}[contact["model"]] for contact in record["contacts"]]
        is_moment = [soft and c == 3 for soft, size in zip(moments, sizes, strict=True) for c in range(size)]
        rows = zip(record["hand"]["jacobian"], is_moment, strict=True)
        record["hand"]["jacobian"] = [row if moment else [length * x for x in row] for row, moment in rows]
    return ForceProblem.from_dict(record)
