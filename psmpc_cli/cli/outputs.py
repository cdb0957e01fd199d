"""What a command would overwrite is found out before its run, not after it."""

from pathlib import Path

from psmpc_cli.errors import InputError


def refuse_old_figures(directory: Path, force: bool) -> None:
    """Refuse to draw where figures, or anything else, stand.

    Raises:
        InputError: The directory is none, or holds something.
    """
    if directory.exists() and not directory.is_dir():
        raise InputError(
            f"{directory} is no directory, but the figures would go there: choose another log with -o, or --no-figures"
        )
    if not force and directory.is_dir() and any(directory.iterdir()):
        raise InputError(
            f"{directory} holds files already: choose another log with -o, overwrite with --force, or use --no-figures"
        )
