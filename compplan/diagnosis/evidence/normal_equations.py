"""Normal equations: inner products of all signatures and observations of a campaign.

With these products, the evidence of any set of effects under any noise and background needs only a small Cholesky
factor; rows of the campaign are not read again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compplan.diagnosis.data.channels import Channel
from compplan.diagnosis.data.shared import ROUNDING
from compplan.effects.signature import Signature
from compplan.measurement.observations import along
from compplan.robot import Array

#: Rounded sizes of groups (assumed: steps of a half, which change the weight of a mean little).
TYPICAL = np.array([1, 2, 3, 4, 6, 9, 14, 22, 34, 52, 80, 120])


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of columns and observations over some rows."""

    count: int  #: Number of values.
    gram: Array  #: Columns with columns. Shape (p, p).
    against: Array  #: Columns with observations. Shape (p,).
    square: float  #: Observations with themselves.


@dataclass(frozen=True, eq=False)
class ChannelProducts:
    """Products of one channel, in units of the noise."""

    name: str  #: Name of the channel.
    total: Products  #: Products of all values.
    #: Products of the group means (times the root of its size) by group size; `total` itself where every group is a
    #: single row.
    means: dict[int, Products]
    degrees_of_freedom: float  #: Degrees of freedom of the noise estimate.


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """All products of a campaign with a list of signatures; p columns."""

    signatures: tuple[Signature, ...]  #: The signatures without their motions, which are in the designs.
    index: tuple[NDArray[np.int_], ...]  #: Columns of each signature; signatures may share columns.
    names: tuple[str, ...]  #: Name of each column.
    scale: Array  #: Scale of each column's parameter. Shape (p,).
    start: Array  #: Parameters at the linearization, in units of their scale. Shape (p,).
    channels: tuple[ChannelProducts, ...]  #: Products channel by channel.
    designs: tuple[Array, ...]  #: Columns of each channel, in units of the noise. Shape (r, c, p) each.
    #: Observations of each channel referred to zero parameters, in units of the noise. Shape (r, c) each.
    observed: tuple[Array, ...]
    source: tuple[Channel, ...]  #: The channels of observations.

    @property
    def p(self) -> int:
        """Number of columns."""
        return len(self.names)

    def columns(self, signature: int) -> NDArray[np.int_]:
        """Return the columns of a signature."""
        return self.index[signature]

    def join_columns(self, signatures: Iterable[int]) -> NDArray[np.int_]:
        """Return the columns of several signatures, shared ones once, ascending."""
        return np.unique(np.concatenate([np.zeros(0, int), *(self.index[number] for number in signatures)]))

    def columns_named(self, *names: str) -> NDArray[np.int_]:
        """Return the columns of all signatures of some effects, ascending."""
        return self.join_columns(number for number, s in enumerate(self.signatures) if s.name in names)

    def left(self, values: Array) -> list[Array]:
        """Return the residuals of each channel for given parameters, in units of the noise, to first order."""
        used = np.flatnonzero(values)
        return [y - design[..., used] @ values[used] for design, y in zip(self.designs, self.observed, strict=True)]


def build_normal_equations(
    channels: Sequence[Channel], signatures: Iterable[Signature], values: dict[str, float]
) -> NormalEquations:
    """Compute the inner products of all columns and observations, the latter referred to zero parameters.

    `values` are the current values of parameters (SI) by column, which are added back.
    """
    kept, index, names, scale, designs = _read_columns(channels, signatures, ())
    offset = np.array([values.get(name, 0.0) for name in names]) / scale
    used = np.flatnonzero(offset)
    observed = [
        channel.residual / channel.sigma + design[..., used] @ offset[used]
        for channel, design in zip(channels, designs, strict=True)
    ]
    products = [_multiply(c, d, y) for c, d, y in zip(channels, designs, observed, strict=True)]
    return NormalEquations(
        signatures=tuple(kept),
        index=tuple(index),
        names=tuple(names),
        scale=scale,
        start=offset,
        channels=tuple(products),
        designs=tuple(designs),
        observed=tuple(observed),
        source=tuple(channels),
    )


def extend_normal_equations(equations: NormalEquations, signatures: Iterable[Signature]) -> NormalEquations:
    """Return normal equations with further signatures appended, zero in the current model."""
    kept, index, names, scale, fresh = _read_columns(equations.source, signatures, equations.names)
    designs = [np.concatenate([old, new], axis=-1) for old, new in zip(equations.designs, fresh, strict=True)]
    products = [
        _multiply(c, d, y, old)
        for c, d, y, old in zip(equations.source, designs, equations.observed, equations.channels, strict=True)
    ]
    return replace(
        equations,
        signatures=(*equations.signatures, *kept),
        index=(*equations.index, *index),
        names=tuple(names),
        scale=np.concatenate([equations.scale, scale]),
        start=np.pad(equations.start, (0, len(scale))),
        channels=tuple(products),
        designs=tuple(designs),
    )


def select_rows(
    equations: NormalEquations, rows: NDArray[np.bool_], columns: NDArray[np.int_]
) -> tuple[ChannelProducts, ...]:
    """Return the products over given rows of the campaign, shape (n,), and given columns only."""
    result = []
    for channel, design, observed in zip(equations.source, equations.designs, equations.observed, strict=True):
        keep = rows[channel.rows]
        part = channel.take(keep)
        kept = design[keep]
        if len(columns) < design.shape[-1]:
            kept = kept[..., columns]
        result.append(_multiply(part, kept, observed[keep]))
    return tuple(result)


def typical_size(sizes: NDArray[np.int_]) -> NDArray[np.int_]:
    """Round sizes of groups to a few; only the weight of their means depends on it."""
    return np.asarray(TYPICAL[np.abs(np.log(sizes[:, None] / TYPICAL)).argmin(1)])


def representable_forms(equations: NormalEquations, special: int) -> set[int]:
    """List forms at the same joint that have more parameters and contain the given form."""
    narrow, joint = equations.columns(special), equations.signatures[special].joint

    def multiply(rows: NDArray[np.int_], columns: NDArray[np.int_]) -> Array:
        return np.asarray(sum(channel.total.gram[np.ix_(rows, columns)] for channel in equations.channels))

    whole, found = np.trace(multiply(narrow, narrow)), set()
    for number, signature in enumerate(equations.signatures):
        wide = equations.columns(number)
        if signature.joint != joint or len(wide) <= len(narrow):
            continue
        across, gram = multiply(wide, narrow), multiply(wide, wide)
        explained = np.trace(across.T @ np.linalg.pinv(gram, rcond=1e-9, hermitian=True) @ across)
        if explained > (1.0 - np.sqrt(ROUNDING)) * whole:
            found.add(number)
    return found


def project_out(gram: Array, nuisance: NDArray[np.int_]) -> Array:
    """Project given columns out of the products of all columns. Shape (p, p)."""
    if not len(nuisance):
        return gram
    block = gram[np.ix_(nuisance, nuisance)]
    block = block + 1e-9 * np.trace(block) / len(block) * np.eye(len(block))
    cross = gram[:, nuisance]
    return np.asarray(gram - cross @ np.linalg.solve(block, cross.T))


def _read_columns(
    channels: Sequence[Channel], signatures: Iterable[Signature], known: Sequence[str]
) -> tuple[list[Signature], list[NDArray[np.int_]], list[str], Array, list[Array]]:
    """Read signatures one by one, so that their motions need not be held together; columns of one name once.

    Returns the signatures without their motions, the columns of each, the names of known and new columns, and scale
    (k,) and designs (r, c, k) of the new ones.
    """
    names, number = list(known), {name: k for k, name in enumerate(known)}
    kept: list[Signature] = []
    index, scale = [], [np.zeros(0)]
    designs = [[np.zeros((*channel.residual.shape, 0))] for channel in channels]
    for signature in signatures:
        fresh = [k for k, name in enumerate(signature.column_names) if name not in number]
        for k in fresh:
            number[signature.column_names[k]] = len(names)
            names.append(signature.column_names[k])
        index.append(np.array([number[name] for name in signature.column_names], int))
        if fresh:
            scale.append(signature.scale[fresh])
            for channel, design in zip(channels, designs, strict=True):
                design.append(_design(channel, signature, fresh))
        kept.append(signature.without_motion())
    return kept, index, names, np.concatenate(scale), [np.concatenate(design, axis=-1) for design in designs]


def _design(channel: Channel, signature: Signature, columns: Sequence[int]) -> Array:
    """Return columns in units of the noise, each scaled by its prior. Shape (r, c, k)."""
    part = {"position": slice(0, 3), "orientation": slice(3, 6)}.get(channel.name, slice(None))
    motion = signature.encoder if channel.name == "encoder" else signature.twist
    rows = channel.rows
    if channel.name == "distance":
        motion, rows = signature.between, np.arange(len(channel.rows))
    if motion is None:
        return np.zeros((*channel.residual.shape, len(columns)))
    design = motion[:, part][rows][..., columns] * (signature.scale[columns] / channel.sigma)[:, None]
    return design if channel.direction is None else along(channel.direction, design)


def _multiply(channel: Channel, design: Array, observed: Array, old: ChannelProducts | None = None) -> ChannelProducts:
    """Multiply columns with columns and observations; blocks in `old` are reused."""
    design, observed, measured = turn_along(channel, design, observed)
    total = _products(design, observed, None if old is None else old.total, measured)
    means: dict[int, Products] = {}
    group = channel.group
    first = np.flatnonzero(np.r_[True, np.diff(group) > 0]) if len(group) else group
    if 0 < len(first) == len(group):
        means[1] = total
    elif len(first):
        sizes = np.diff(np.r_[first, len(group)])
        root = np.sqrt(sizes)[:, None]
        mean_design = np.add.reduceat(design, first, axis=0)
        mean_design /= root[:, :, None]
        mean_observed = np.add.reduceat(observed, first, axis=0) / root
        mean_measured = np.logical_or.reduceat(measured, first, axis=0)
        sizes = typical_size(sizes)
        for size in np.unique(sizes):
            chosen = sizes == size
            known = None if old is None else old.means[int(size)]
            means[int(size)] = _products(mean_design[chosen], mean_observed[chosen], known, mean_measured[chosen])
    return ChannelProducts(channel.name, total, means, channel.noise.degrees_of_freedom)


def turn_along(channel: Channel, design: Array, observed: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Rotate rows that measure one value so that it is first; also return which values are measured. Shape (r, c)."""
    measured = np.ones(observed.shape, bool)
    if channel.direction is None:
        return design, observed, measured
    one = np.isfinite(channel.direction).all(axis=1)
    measured[one, 1:] = False
    design, observed = design.copy(), observed.copy()
    unit = channel.direction[one]
    design[one, 0], observed[one, 0] = np.einsum("ni,nip->np", unit, design[one]), np.sum(unit * observed[one], axis=1)
    design[one, 1:], observed[one, 1:] = 0.0, 0.0
    return design, observed, measured


def _products(design: Array, observed: Array, old: Products | None, measured: NDArray[np.bool_]) -> Products:
    # without parameters there are no columns, and the shape does not contain the number of values
    flat, y = design.reshape(observed.size, design.shape[-1]), observed.reshape(-1)
    if old is None:
        return Products(int(measured.sum()), flat.T @ flat, flat.T @ y, float(y @ y))
    p, count = len(old.against), flat.shape[1]
    fresh = np.ascontiguousarray(flat[:, p:])
    gram = np.empty((count, count))
    gram[:p, :p] = old.gram
    gram[p:] = fresh.T @ flat
    gram[:p, p:] = gram[p:, :p].T
    return Products(int(measured.sum()), gram, np.concatenate([old.against, fresh.T @ y]), old.square)
