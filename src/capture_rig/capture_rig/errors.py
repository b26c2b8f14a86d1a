"""The one error a user sees when something they gave us cannot be used."""

MOST = 1000  # characters of a part of the message: values in broken files may be of any length


class InputError(ValueError):
    """A file, key, topic or value given by the user cannot be used.

    The text reads ``WHERE: WHAT. REMEDY``: the place (file, key, topic), the fault (with the offending value), and the
    user's remedy.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = shortened(what, MOST), shortened(where, MOST), remedy
        sentence = self.what if self.what.endswith((".", "!", "?")) else self.what + "."
        super().__init__((f"{self.where}: " if where else "") + sentence + (f" {remedy}" if remedy else ""))

    def __reduce__(self) -> tuple:
        return _rebuild, (self.what, self.where, self.remedy)


def _rebuild(what: str, where: str, remedy: str) -> InputError:
    return InputError(what, where=where, remedy=remedy)


def shortened(text: str, most: int = 300) -> str:
    """Return ``text``, its middle left out when it is longer than ``most`` characters."""
    return text if len(text) <= most else f"{text[: most // 2]}...{text[-most // 2 :]}"
