"""The one error a user sees when something they gave us cannot be used."""


class InputError(ValueError):
    """A file, key, topic or value given by the user cannot be used.

    The text reads ``WHERE: WHAT. REMEDY``: where it was found (file, key, topic), what is wrong with it
    (with the offending value), and what the user can do about it.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, where, remedy
        sentence = what if what.endswith((".", "!", "?")) else what + "."
        super().__init__((f"{where}: " if where else "") + sentence + (f" {remedy}" if remedy else ""))

    def __reduce__(self) -> tuple:
        return _rebuild, (self.what, self.where, self.remedy)


def _rebuild(what: str, where: str, remedy: str) -> InputError:
    return InputError(what, where=where, remedy=remedy)
