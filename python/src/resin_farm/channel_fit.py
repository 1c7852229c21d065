"""The fit of one channel: the records that were compared, the continuous optimum, and its error bars."""

from __future__ import annotations

from dataclasses import dataclass, field

from resin_farm.medium import Array, Interval, Medium, SecondLobe


@dataclass(frozen=True)
class Candidate:
    """A record that was compared."""

    medium: Medium
    sample_ior: float
    error: float
    """The minimised objective: Eq. 1 of the paper, or the misfit by the likelihood."""
    records: tuple[int | None, ...]
    """Numbers of its records in the dictionary, one for each thickness."""


@dataclass(frozen=True)
class NuisanceEstimate:
    """An estimate of a nuisance of the set-up, with its prior."""

    name: str
    """`scale`, `blur_variance_mm2`, `thickness_mm`, `origin_mm`, `gain`, `zero` or `slope`."""
    slab_mm: float | None
    """The slab that it belongs to, by its nominal thickness; None if all do."""
    value: float
    std_error: float
    prior: float
    prior_std_error: float | None
    """None without a prior."""


@dataclass(frozen=True)
class SourceShare:
    """Share of a source of error in the variances of ln σ_t, √(1 - α), ln σ_s(1 - g) and √σ_a; they sum to 1."""

    source: str
    """`noise`, `dictionary`, `thickness`, `origin`, `blur`, `gain`, `zero`, `slope`, `scale`, `other_channels`, `g`,
    `scene`."""
    sigma_t: float
    albedo: float
    reduced_scattering: float
    absorption: float
    quantity: str | None = None
    """The quantity of the scene, if the source is `scene`."""


@dataclass(frozen=True)
class SceneEstimate:
    """An estimate of an uncertain quantity of the scene, with its prior."""

    quantity: str
    """Name, such as `gel thickness` or `sample second lobe weight`."""
    unit: str
    """`mm`, `°`, or empty for pure numbers."""
    scope: str
    """The scope within which the quantity has this value: `session`, `slab`, `material` or `channel`."""
    slab_mm: float | None
    """The slab that it belongs to, by its nominal thickness."""
    value: float
    std_error: float
    prior: float
    prior_std_error: float
    at_end: bool
    """The estimate lies at the end of the range of the dictionary's responses: the true value may lie beyond it."""


@dataclass(frozen=True)
class Likelihood:
    """Results of the likelihood for a channel, in addition to its medium."""

    chi2: float
    degrees_of_freedom: float
    probability: float
    """Probability of a χ² at least as large from noise alone."""
    nuisances: tuple[NuisanceEstimate, ...]
    outliers: int
    """Pixels that were given no weight."""
    budget: tuple[SourceShare, ...] = ()
    """Shares of the variances of the medium by source; empty if the data determine nothing."""
    scene: tuple[SceneEstimate, ...] = ()
    """Uncertain quantities of the scene; empty if it was taken as exact."""


# eq=False: the equality of arrays has no single truth value.
@dataclass(frozen=True, eq=False)
class Refined:
    """A continuous optimum, with error bars of 95 %."""

    medium: Medium
    sigma_t_per_mm: Interval
    albedo: Interval
    g: Interval
    """Of the anisotropy, the mean cosine of the phase function."""
    reduced_scattering_per_mm: Interval
    absorption_per_mm: Interval
    resolved: bool
    """Whether the data determine σ_t and the albedo: both intervals are bounded and narrow."""
    resolved_at_g: bool
    """Whether the data would determine them with g held at its best value; if this alone is true, g is open."""
    valley: bool
    """σ_t and g trade off along media that are equivalent by similarity theory."""
    misfit: float
    """Root mean square of the residuals over the noise: 1 if noise alone explains them."""
    error: float
    covariance: Array = field(repr=False)
    """Covariance of (ln σ_t, √(1 − α), ln(1 − g)); zeros where a parameter was held."""
    likelihood: Likelihood = field(repr=False)
    suspicion: str | None = None
    """The most likely single cause of a misfit beyond noise."""
    second_lobe: SecondLobe | None = None
    """The second lobe of the phase function, at its estimate; None if the function has none. `likelihood.scene` has
    the standard errors of what was estimated, with the priors."""


@dataclass(frozen=True, eq=False)
class Curves:
    """The compared profiles at one thickness."""

    thickness_mm: float
    x_mm: Array
    measured: Array
    """Measured values times μ, on the dictionary's pixels."""
    best_record: Array
    refined: Array | None
    residuals: Array | None = None
    """Measured less refined values over their standard errors; None without likelihood."""
    left_out: Array | None = None
    """Indices of pixels that the likelihood leaves out, such as dust."""


@dataclass(frozen=True)
class ChannelFit:
    """One channel of a material."""

    channel: str
    candidates: tuple[Candidate, ...]
    refined: Refined | None
    outside: str | None
    """`brighter` or `darker`, if a profile's mean lies beyond that of every record."""
    curves: tuple[Curves, ...] = field(default=(), repr=False)

    @property
    def medium(self) -> Medium:
        """The continuous optimum; without one the best record's medium."""
        return self.refined.medium if self.refined else self.candidates[0].medium

    @property
    def second_lobe(self) -> SecondLobe | None:
        """The second lobe of the continuous optimum's phase function; None if the function has none, and without an
        optimum."""
        return self.refined.second_lobe if self.refined else None
