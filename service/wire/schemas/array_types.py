"""Types of the numbers and arrays in records, for their schemas."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

Numbers = list[float]  # (n,)
Rows = list[list[float]]  # (m, n), by rows
Vector3 = Annotated[list[float], Meta(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Meta(min_length=4, max_length=4)]
Vector6 = Annotated[list[float], Meta(min_length=6, max_length=6)]
Matrix3 = Annotated[list[Vector3], Meta(min_length=3, max_length=3)]
Matrix6 = Annotated[list[Vector6], Meta(min_length=6, max_length=6)]
Rows3 = list[Vector3]  # (m, 3)
Rows6 = list[Vector6]  # (m, 6)
NumberOrList = float | list[float]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Index = Annotated[int, Meta(ge=0)]
