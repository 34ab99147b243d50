"""Pages of the documentation by their titles, which hold for an installed package too: what help and errors name."""

START = "Start here"
OUTCOMES = "Errors, outcomes and verdicts"


def see(title: str) -> str:
    """The sentence that names a page."""
    return f"See the page '{title}'."


def pointed(error: object, title: str) -> str:
    """An error that names a page: its own, or the one of the command."""
    said = str(error).rstrip()
    return said if "See the page '" in said else f"{said}{'' if said.endswith(('.', '!', '?')) else '.'} {see(title)}"


def closing(title: str, *examples: str) -> str:
    """What a command's help ends with: examples, and the page that explains it."""
    return "\n".join([f"example{'s' * (len(examples) > 1)}:", *(f"  {line}" for line in examples), "", see(title)])
