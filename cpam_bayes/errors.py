"""The errors a user can cause while describing a plate or calling a function."""

from __future__ import annotations

_WINDOW = 60


class PlateFileError(ValueError):
    """Everything that is wrong with one plate file, one problem a line.

    problems : each "file:line: key: what was wrong, the value received, what is accepted"
    """

    def __init__(self, *problems: str) -> None:
        super().__init__(*problems)

    @property
    def problems(self) -> tuple[str, ...]:
        """The problems in the order of their lines."""
        return tuple(str(problem) for problem in self.args)

    def __str__(self) -> str:
        return "\n".join(self.problems)


class ArgumentError(TypeError, ValueError):
    """An argument of a type that a function does not take."""

    def __init__(self, name: str, received: str, accepted: str) -> None:
        super().__init__(name, received, accepted)

    def __str__(self) -> str:
        name, received, accepted = self.args
        return f"{name}: received {received}, accepted: {accepted}"


class LayupError(ValueError):
    """A layup that cannot be read, with the place where reading stopped."""

    def __init__(self, text: str, position: int, what: str) -> None:
        super().__init__(text, position, what)

    @property
    def text(self) -> str:
        """The layup as received."""
        return str(self.args[0])

    @property
    def position(self) -> int:
        """Index into the text, from 0."""
        return int(self.args[1])

    @property
    def what(self) -> str:
        """What was wrong and what is accepted."""
        return str(self.args[2])

    def __str__(self) -> str:
        shown, caret = _excerpt(self.text, self.position)
        return f"{self.what} (character {self.position + 1})\n  {shown}\n  {' ' * caret}^"


def _excerpt(text: str, position: int) -> tuple[str, int]:
    """Cut a long text around `position`; unprintable characters would move the caret."""
    start = max(0, position - _WINDOW) if len(text) > 2 * _WINDOW else 0
    stop = min(len(text), position + _WINDOW) if len(text) > 2 * _WINDOW else len(text)
    shown = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text[start:stop])
    head = "..." if start else ""
    tail = "..." if stop < len(text) else ""
    return f"{head}{shown}{tail}", len(head) + position - start
