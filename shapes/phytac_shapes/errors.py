"""The error classes of all packages. A message names what failed, what was got, and the fix."""


def cause_of(error: Exception) -> str:
    """Text of another library's error, truncated: it may quote a whole malformed file."""
    cause_max = 2000
    text = str(error)
    return text if len(text) <= cause_max else text[:cause_max] + " …"


class PhytacError(Exception):
    """Base of every error a user can cause; the command line prints its text and exits.

    Attributes
    ----------
    exit_code : int
        Process exit code used by the command line (see ``docs/formats.md``).
    """

    exit_code = 1


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
