"""The error classes of all packages. A message names what failed, what was got, and the fix."""


def cause_of(error: Exception) -> str:
    """Text of another library's error, truncated: it may quote a whole malformed file."""
    cause_max = 2000
    text = str(error)
    return text if len(text) <= cause_max else text[:cause_max] + " …"


class PhytacError(Exception):
    """Base of every error a user can cause; the command line prints its text and exits.

    Parameters
    ----------
    code : str
        Stable name of the failure in kebab-case, such as ``wall-too-thin``, for programs.
    message : str
        Text for people, the ``str`` of the error; its wording may change.

    Attributes
    ----------
    code : str
        As given. Each code belongs to one class of errors.
    exit_code : int
        Process exit code used by the command line (see ``docs/formats.md``).
    """

    exit_code = 1

    def __init__(self, code: str, message: str) -> None:
        super().__init__(code, message)
        self.code = code

    def __str__(self) -> str:
        return str(self.args[1])


class DesignError(PhytacError):
    """The design file, or the geometry it describes, cannot be built."""

    exit_code = 2


class OutputError(PhytacError):
    """A folder or file cannot be written, or belongs to something else."""

    exit_code = 3


class InputError(PhytacError):
    """A file handed in (image, bundle, mesh, data) is not usable."""

    exit_code = 4


class NumericalError(PhytacError):
    """A computation cannot vouch for its result (singular, not converged, not finite)."""

    exit_code = 5


class CadKernelError(NumericalError):
    """A solid that the CAD kernel cannot make in one sound piece; printed meshes do not need it."""


class MissingPartError(PhytacError):
    """An optional part (library or system package) that this work needs is not installed."""

    exit_code = 6

    @classmethod
    def of_library(cls, work: str, library: str, extra: str) -> "MissingPartError":
        """Return the error of a library that comes with an extra of phytac-design."""
        return cls(
            "missing-library",
            f"{work} needs {library}; install it with: pip install 'phytac-design[{extra}]'",
        )
