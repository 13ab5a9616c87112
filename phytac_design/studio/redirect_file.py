"""Opens the studio in a browser without its token on the browser's command line.

Every user of a machine can list the command lines of all processes. The browser therefore gets the
name of a file that only its own user can read, and that page leads on to the address.
"""

import html
import os
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import NamedTemporaryFile


@contextmanager
def opened_in_browser(url: str, folder: Path) -> Iterator[bool]:
    """Open an address; its file exists while the block lasts.

    Parameters
    ----------
    url : str
        Address with a secret.
    folder : Path
        Where to write the file, if possible: browsers in a sandbox (snap) cannot read the folder
        of temporary files, which is used otherwise.

    Yields
    ------
    bool
        Whether a browser was found.
    """
    address = html.escape(url)
    page = (
        f'<!doctype html><meta charset="utf-8"><title>PhyTac studio</title>'
        f'<meta http-equiv="refresh" content="0;url={address}"><a href="{address}">The studio</a>\n'
    )
    where = folder if os.access(folder, os.W_OK) else None
    # Readable by its owner alone, as all temporary files are.
    with NamedTemporaryFile("w", prefix="phytac-studio-", suffix=".html", dir=where) as file:
        file.write(page)
        file.flush()
        yield webbrowser.open(Path(file.name).as_uri())
