"""Lazy fields: computed once, at the first access."""

from __future__ import annotations

from graspforce.core.lazy_field import LazyField


class Square:
    """A record with a lazy field."""

    def __init__(self, side: float) -> None:
        self.side, self.computed = side, 0

    def _measure(self) -> float:
        """Area, m²."""
        self.computed += 1
        return self.side**2

    area = LazyField(_measure)


def test_lazy_field_is_computed_once() -> None:
    square = Square(3.0)
    assert "area" not in vars(square)
    assert (square.area, square.area, square.computed) == (9.0, 9.0, 1)
    assert vars(square)["area"] == 9.0


def test_lazy_field_of_each_instance_is_its_own() -> None:
    first, second = Square(1.0), Square(2.0)
    assert (first.area, second.area) == (1.0, 4.0)


def test_lazy_field_read_from_the_class_is_the_field_with_its_documentation() -> None:
    assert isinstance(Square.area, LazyField)
    assert Square.area.__doc__ == "Area, m²."
