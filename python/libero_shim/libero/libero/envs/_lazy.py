"""An observation whose pictures are drawn when they are first read.

Drawing takes most of a step's time, and most programs use few of the returned observations: none
while objects settle, and only the last of a chunk of actions."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, ItemsView, Iterator, ValuesView
from typing import Any

from numpy.typing import NDArray

_MISSING = object()


class Undrawn:
    """Placeholder of a picture that is not drawn yet. `draw` renders the picture from the recorded
    poses of its observation."""

    __slots__ = ("_array", "_draw")

    def __init__(self, draw: Callable[[], NDArray[Any]]) -> None:
        self._draw: Callable[[], NDArray[Any]] | None = draw
        self._array: NDArray[Any] | None = None

    def array(self) -> NDArray[Any]:
        """Returns the picture, which is always the same array."""
        draw = self._draw
        if draw is not None and self._array is None:
            self._array = draw()
            # Frees the recorded poses.
            self._draw = None
        assert self._array is not None
        return self._array


class _Values(ValuesView[Any]):
    def __reversed__(self) -> Iterator[Any]:
        return (self._mapping[key] for key in reversed(self._mapping))  # type: ignore[call-overload]


class _Items(ItemsView[str, Any]):
    def __reversed__(self) -> Iterator[tuple[str, Any]]:
        return ((key, self._mapping[key]) for key in reversed(self._mapping))  # type: ignore[call-overload]


class Observation(OrderedDict[str, Any]):
    """An observation that draws its pictures when they are read. Its methods, its copies and its
    pickles give the same arrays as an observation that is drawn at once. A pickle or deep copy is a
    plain `OrderedDict` of these arrays."""

    def draw(self) -> None:
        """Draws all pictures that are not drawn yet."""
        for key in self:
            self[key]

    def change(self, key: str, function: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
        """Replaces a picture by `function(picture)`, computed when the key is first read."""
        picture = super().__getitem__(key)
        self[key] = Undrawn(
            lambda: function(picture.array() if type(picture) is Undrawn else picture)
        )

    def __getitem__(self, key: str) -> Any:
        value = super().__getitem__(key)
        if type(value) is Undrawn:
            value = value.array()
            # `dict`'s method suffices, because the order of existing keys does not change.
            dict.__setitem__(self, key, value)
        return value

    # CPython's `dict(observation)` does not call `__getitem__` of a subclass of `dict`, unless the
    # subclass defines `__iter__`.
    def __iter__(self) -> Iterator[str]:
        return super().__iter__()

    def items(self) -> Any:
        return _Items(self)

    def values(self) -> Any:
        return _Values(self)

    def get(self, key: str, default: Any = None) -> Any:
        return self[key] if key in self else default

    def pop(self, key: str, default: Any = _MISSING) -> Any:
        if key not in self and default is not _MISSING:
            return default
        value = self[key]
        del self[key]
        return value

    def popitem(self, last: bool = True) -> tuple[str, Any]:
        key, value = super().popitem(last)
        return key, value.array() if type(value) is Undrawn else value

    def setdefault(self, key: str, default: Any = None) -> Any:
        if key not in self:
            self[key] = default
        return self[key]

    def copy(self) -> Observation:
        copied = Observation()
        for key in self:
            # The copy shares the picture's placeholder, so that the picture is drawn once.
            copied[key] = super().__getitem__(key)
        return copied

    __copy__ = copy

    def __reduce_ex__(self, _protocol: Any) -> Any:
        return OrderedDict, (), None, None, iter(self.items())

    def __eq__(self, other: object) -> bool:
        self.draw()
        if isinstance(other, Observation):
            other.draw()
        return super().__eq__(other)

    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        self.draw()
        return super().__repr__()
