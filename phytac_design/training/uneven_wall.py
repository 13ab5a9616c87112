r"""Training of a print's wall: where it is thicker or thinner than designed.

Casting and printing leave walls of uneven thickness. A contact then moves the markers by another
pattern than the design's tables have, also far away, where other contacts press. With adjoint
motions Z of the images, ``K·Z = Hᵀ``, and the motion x under known contacts, a factor 1 + θ on the
thickness of an element changes the shifts, to first order, by ::

    -Zᵀ·(t ∂K/∂t)·x·θ

(Haug, Choi and Komkov 1986, ch. 1: the adjoint method). θ is a Gaussian process over the wall, and
has the posterior mean under all shifts of the samples (linear Bayesian inverse problem; Tarantola
2005, ch. 3). Tables of the print are then those of its own shell, solved again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from phytac_decoder.mechanics.response_table import ResponseTable
from phytac_design.datasets.samples import TouchRows
from phytac_design.mechanics.indenter import Indentations
from phytac_design.mechanics.shell.discretisation import force_ratio
from phytac_design.mechanics.shell.pressure import indentation_loads
from phytac_design.mechanics.shell.shell_element import ElementStiffness
from phytac_design.mechanics.shell.solve import ShellModel, clamped_model
from phytac_design.simulation.pressed_series import RATIO_MAX, DiscResponse, ImageResponse
from phytac_design.training.marker_gain import KnownContacts, PredictionResiduals
from phytac_shapes.arrays import FloatArray, IntArray


@dataclass(frozen=True, kw_only=True)
class UnevenWallSettings:
    """Settings of the fit, chosen on one virtual print of each of six designs."""

    share: float = 0.03
    """Prior standard deviation of the thickness, and of the common factor of stiffness, which is
    left free beside it."""
    length: float = 0.1
    """Correlation length over the root of the wall's area: long waves."""
    modes_min: float = 1e-3
    """Least variance of a mode of the thickness, over the largest."""
    model_error: float = 0.1
    """Share of the motion that the tables miss besides, independently for each marker. They miss
    3 to 5 %, alike for the markers around a contact; with 10 % the thickness found has the spread
    of the true one, or less."""
    samples_max: int = 200
    """Samples that are fitted to, at most: they bound time and memory."""
    blocks_min: int = 5
    """Fewer blocks of samples say nothing."""
    explained_min: float = 0.002
    """Share of the squared residuals of held-out samples that the thickness explains, at least."""
    folds: int = 5
    """Parts of the samples that are held out in turn."""
    factor_min: float = 0.5
    """Least factor on the thickness: first order holds for small changes."""
    numbers_max: int = 150_000_000
    """Numbers in the adjoint motions, at most (600 MB): larger shells are taken as even."""
    elements_at_once: int = 64
    places_at_once: int = 256
    markers_at_once: int = 32
    """They bound the memory."""


SETTINGS = UnevenWallSettings()
WallSolver = Callable[[], "UnevenWall | None"]
"""Makes the design's shell when it is needed; None where it is too large."""


@dataclass(frozen=True, kw_only=True)
class WallThickness:
    """Thickness of a print.

    Attributes
    ----------
    factor : (E,) float
        Thickness of each element over the designed one.
    common : float
        Factor on all shifts besides.
    explained : float
        Share of the weighted squared residuals of held-out samples that it explains.
    """

    factor: FloatArray
    common: float
    explained: float

    @property
    def facts(self) -> dict[str, float]:
        """Figures, relative to the designed thickness: spread, thinnest and thickest part."""
        return {
            "thickness_sd": float(self.factor.std()),
            "thinnest": float(self.factor.min()),
            "thickest": float(self.factor.max()),
            "explained": self.explained,
        }


class UnevenWall:
    """The shell of a design, and what its cameras see of a change of its thickness.

    Parameters
    ----------
    shell : DiscResponse
        The decoder's own shell.
    see : ImageResponse
        What the cameras see.
    """

    def __init__(self, shell: DiscResponse, see: ImageResponse) -> None:
        self.shell, self.see = shell, see
        corners = shell.model.nodes_mm[shell.model.quads]
        self._centre_mm = corners.mean(axis=1)
        self._dofs = (6 * shell.model.quads[:, :, None] + np.arange(6)).reshape(len(corners), -1)

    @staticmethod
    def fits_in_memory(model: ShellModel, markers: int) -> bool:
        """Whether the adjoint motions of so many markers' images can be kept."""
        return model.fixed.size * 2 * markers <= SETTINGS.numbers_max

    def _adjoint(self, model: ShellModel) -> NDArray[np.float32]:
        """Motions (6N, 2n) whose work with a load is what it shifts the images by, px."""
        slope = self.see.slope
        count, once = len(slope), SETTINGS.markers_at_once
        out = np.empty((model.fixed.size, 2 * count), dtype=np.float32)
        for first in range(0, count, once):
            some = np.arange(first, min(first + once, count))
            rows = np.zeros((len(some), 2, count, 6))
            rows[range(len(some)), :, some] = slope[some]
            push = self.shell.kinematics.matrix.T @ rows.reshape(2 * len(some), -1).T
            push[model.fixed.ravel()] = 0.0
            motion = model.solve(push).motion.reshape(push.shape)
            out[:, 2 * first : 2 * first + 2 * len(some)] = motion
        return out

    @cached_property
    def _designed(self) -> NDArray[np.float32]:
        return self._adjoint(self.shell.model)

    @cached_property
    def _rates(self) -> NDArray[np.float32]:
        """How the stiffness (E, 24, 24) of each element grows with its thickness, relative."""
        model, parts = self.shell.model, self.shell.model.elements
        slope = ElementStiffness(
            membrane=parts.membrane, bending=3.0 * parts.bending, shear=parts.shear
        )
        rates = slope.combine(modulus_MPa=model.modulus_MPa, thickness_mm=model.thickness_mm)
        return rates.astype(np.float32)

    @cached_property
    def _modes(self) -> FloatArray:
        """Changes of thickness (E, m), each as likely as the others beforehand."""
        points = self.see.watched - self.see.arm_mm
        length_mm = SETTINGS.length * np.sqrt(self.shell.surface.area_mm2())

        def correlation(one: FloatArray, other: FloatArray) -> FloatArray:
            square = cdist(one, other, "sqeuclidean")
            return np.asarray(np.exp(-square / (2.0 * length_mm**2)))

        size, axes = np.linalg.eigh(correlation(points, points))
        kept = size > SETTINGS.modes_min * size[-1]
        spread = axes[:, kept] / np.sqrt(size[kept])
        return np.asarray(SETTINGS.share * correlation(self._centre_mm, points) @ spread)

    def fit(
        self,
        seen: PredictionResiduals,
        pressed: KnownContacts,
        touches: TouchRows,
        block: IntArray,
        *,
        stiffness: float,
        radius_mm: float,
        rest_px: float,
    ) -> WallThickness | None:
        """Return the thickness behind residuals; None if it does not explain held-out samples.

        Parameters
        ----------
        seen, pressed : PredictionResiduals, KnownContacts
            Residuals of samples by the tables, and their contacts.
        touches : TouchRows
            The contacts, as known.
        block : (s,) int
            Block of each sample: those of one are held out together.
        stiffness : float
            Of the print over the design's, as the tables have it.
        radius_mm : float
            Of contacts whose radius is unknown.
        rest_px : float
            Noise of a marker that does not move.
        """
        rows = np.unique(pressed.row)
        if len(rows) > SETTINGS.samples_max:
            rng = np.random.default_rng(0)
            rows = np.sort(rng.permutation(rows)[: SETTINGS.samples_max])
        residual = seen.residual_px[rows].reshape(len(rows), -1)
        predicted = seen.predicted_px[rows]
        known = np.isfinite(residual) & ~np.repeat(seen.on[rows], 2, axis=1)
        moved = np.repeat(np.mean(predicted**2, axis=2), 2, axis=1)
        weight = known / (rest_px**2 + SETTINGS.model_error**2 * moved)
        slope = self._slopes(self._load(pressed, touches, rows, radius_mm) / stiffness)
        common = SETTINGS.share * predicted.reshape(1, len(rows), -1)
        slope = np.concatenate([slope, common.astype(np.float32)])
        sums = _NormalEquations.of(slope, np.where(known, residual, 0.0), weight, block[rows])
        explained = sums.explained()
        if not explained >= SETTINGS.explained_min:
            return None
        theta = sums.solution()
        factor = 1.0 + self._modes @ theta[:-1]
        return WallThickness(
            factor=np.maximum(factor, SETTINGS.factor_min),
            common=float(1.0 + SETTINGS.share * theta[-1]),
            explained=explained,
        )

    def _load(
        self, pressed: KnownContacts, touches: TouchRows, rows: IntArray, radius_mm: float
    ) -> FloatArray:
        """Loads (6N, s), N and N mm, that move a linear wall about as far as samples (s,) do.

        The force of a contact is ``KnownContacts.linear_N``, in which friction, and where in its
        place of the tables it presses, count for a percent or two.
        """
        mine = np.isin(pressed.row, rows)
        touch = pressed.touch[mine]
        known_mm = touches.radius_mm[touch]
        contacts = Indentations(
            uv=touches.uv[touch],
            radius_mm=np.where(known_mm > 0.0, known_mm, radius_mm),
            force_N=np.ones(len(touch)),
            indenter=touches.indenter[touch],
            length_mm=touches.length_mm[touch],
            turn_rad=touches.turn_rad[touch],
            friction=touches.friction[touch],
        )
        shell = self.shell
        unit = indentation_loads(shell.mesh, shell.surface, contacts, holes=shell.holes)
        share = np.zeros((len(touch), len(rows)))
        share[range(len(touch)), np.searchsorted(rows, pressed.row[mine])] = pressed.linear_N[mine]
        return np.asarray(unit @ share)

    def _slopes(self, load: FloatArray) -> NDArray[np.float32]:
        """Shifts (m, s, 2n) px under loads (6N, s) by each mode."""
        motion = self.shell.model.solve(load).motion.reshape(load.shape).astype(np.float32)
        modes, count = self._modes.astype(np.float32), load.shape[1]
        out = np.zeros((modes.shape[1], self._designed.shape[1] * count), dtype=np.float32)
        for first in range(0, len(modes), SETTINGS.elements_at_once):
            some = slice(first, first + SETTINGS.elements_at_once)
            dofs = self._dofs[some]
            work = self._designed[dofs].transpose(0, 2, 1) @ self._rates[some] @ motion[dofs]
            out -= modes[some].T @ work.reshape(len(dofs), -1)
        return np.ascontiguousarray(out.reshape(len(out), -1, count).swapaxes(1, 2))

    def table(self, places: ResponseTable, thickness: WallThickness) -> ResponseTable:
        """Return the tables of a design for a print with another thickness.

        Interactions of contacts, and how flat walls stretch, stay the design's.

        The linear part changes as that of the shell on its own mesh does, and the k-th power of the
        force with the k-th power of the ratio of linear motions.
        """
        model = self.shell.model
        print_adjoint = self._adjoint(
            clamped_model(
                self.shell.mesh,
                thickness_mm=model.thickness_mm * thickness.factor,
                modulus_MPa=model.modulus_MPa * np.ones(len(thickness.factor)),
                poisson=model.poisson,
            )
        )
        both = (self._designed, print_adjoint)
        rows = places.shift_px
        before, after = self._shifts(places, both, (0.0, 0.0))
        # The tables' own mesh and stiffness may be others.
        size = np.linalg.norm(before, axis=1)
        ratio = np.linalg.norm(rows[:, 0], axis=1) / np.maximum(size, 1e-12 * size.max())
        usual = float(np.median(ratio))
        ratio = np.clip(ratio, usual / RATIO_MAX, usual * RATIO_MAX)
        first = rows[:, 0] + ratio[:, None] * (after - before)
        # As other shells do, see scaled_powers; rows of flat walls are per newton.
        power = np.ones(rows.shape[1])
        power[: places.orders] = np.arange(1, places.orders + 1)
        softer = [force_ratio(new, old) for new, old in zip(first, rows[:, 0], strict=True)]
        changed = rows * (np.array(softer)[:, None] ** power)[:, :, None]
        changed[:, 0] = first
        out = places.with_rows(changed.astype(np.float32))
        if places.shear is None:
            return out
        shear = places.shear
        pressed = self._shifts(shear, both, (0.0, 0.0))
        changes = []
        for friction in ((1.0, 0.0), (0.0, 1.0)):
            dragged = self._shifts(shear, both, friction)
            changes.append((dragged[1] - pressed[1]) - (dragged[0] - pressed[0]))
        more = usual * np.stack(changes, axis=1)
        own = shear.with_rows(shear.shift_px + more.astype(np.float32))
        return out.with_rows(out.shift_px, shear=own)

    def _shifts(
        self,
        places: ResponseTable,
        adjoint: Sequence[NDArray[np.float32]],
        friction: tuple[float, float],
    ) -> list[FloatArray]:
        """Linear shifts (p, 2n) px by a newton on the tables' discs, one array a shell.

        Parameters
        ----------
        places : ResponseTable
            p places.
        adjoint : sequence of (6N, 2n) float32
            Of each shell, see :meth:`_adjoint`.
        friction : (2,) float
            Force along the surface over the normal force, along and around.
        """
        uv = self.shell.surface.chart(places.point_mm)
        parts = []
        for first in range(0, len(uv), SETTINGS.places_at_once):
            some = uv[first : first + SETTINGS.places_at_once]
            loads = self.shell.loads(some, places.radius_mm, friction)
            parts.append([loads.T @ each for each in adjoint])
        return [np.concatenate(each) for each in zip(*parts, strict=True)]


@dataclass(frozen=True, kw_only=True)
class _NormalEquations:
    """Normal equations of a linear fit with unit normal priors, by parts of the data.

    Attributes
    ----------
    matrix, right, square : (folds, m, m), (folds, m), (folds,) float
        Of each part; the weighted square of what is fitted.
    """

    matrix: FloatArray
    right: FloatArray
    square: FloatArray

    @classmethod
    def of(
        cls, slope: NDArray[np.float32], value: FloatArray, weight: FloatArray, block: IntArray
    ) -> "_NormalEquations":
        """Sums over slopes (m, s, d), values and weights (s, d); blocks (s,) are not divided."""
        _, number_of = np.unique(block, return_inverse=True)
        fold = number_of % SETTINGS.folds
        matrix, right, square = [], [], []
        for number in range(SETTINGS.folds):
            mine = fold == number
            rows = slope[:, mine].astype(np.float64)
            rows = rows.reshape(len(slope), rows[0].size)
            each, own = weight[mine].ravel(), value[mine].ravel()
            weighted = rows * each
            matrix.append(weighted @ rows.T)
            right.append(weighted @ own)
            square.append(float(each @ own**2))
        return cls(matrix=np.array(matrix), right=np.array(right), square=np.array(square))

    def solution(self, *, without: int | None = None, last: bool = False) -> FloatArray:
        """Posterior mean (m,) by all parts, or by all but one; or of the last unknown alone."""
        parts = [k for k in range(len(self.square)) if k != without]
        matrix = self.matrix[parts].sum(axis=0) + np.eye(self.matrix.shape[1])
        right, out = self.right[parts].sum(axis=0), np.zeros(self.matrix.shape[1])
        own = slice(-1, None) if last else slice(None)
        out[own] = np.linalg.solve(matrix[own, own], right[own])
        return out

    def explained(self) -> float:
        """Share of each part's squares that the others' fits explain beyond their last unknown."""
        square = dict.fromkeys((False, True), 0.0)
        for last in square:
            for number, whole in enumerate(self.square):
                theta = self.solution(without=number, last=last)
                fitted = theta @ (self.matrix[number] @ theta - 2.0 * self.right[number])
                square[last] += float(whole + fitted)
        return 1.0 - square[False] / square[True] if square[True] > 0.0 else 0.0
