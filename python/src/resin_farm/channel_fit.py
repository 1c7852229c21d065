"""The fit of one channel: the records that were compared, the continuous optimum, and its error bars."""

from __future__ import annotations

from dataclasses import dataclass, field

from resin_farm import _display
from resin_farm.medium import Array, Interval, Medium, SecondLobe


@dataclass(frozen=True)
class Candidate:
    """A record that was compared."""

    medium: Medium
    """The record's medium."""
    sample_ior: float
    """The record's refractive index."""
    error: float
    """The minimised objective: Eq. 1 of the paper, or the misfit by the likelihood."""
    records: tuple[int | None, ...]
    """Numbers of its records in the dictionary, one for each thickness."""

    def __repr__(self) -> str:
        return _display.short(self, f"{self.medium}, ior {self.sample_ior:g}: error {_display.number(self.error)}")


@dataclass(frozen=True)
class NuisanceEstimate:
    """An estimate of a nuisance of the set-up, with its prior."""

    name: str
    """`scale`, `blur_variance_mm2`, `thickness_mm`, `origin_mm`, `gain`, `zero`, `slope` or `wedge`."""
    slab_mm: float | None
    """The slab that it belongs to, by its nominal thickness; None if all do."""
    value: float
    """The estimate, in the unit of the name's ending."""
    std_error: float
    """Its standard error."""
    prior: float
    """The mean of the prior."""
    prior_std_error: float | None
    """None without a prior."""

    def __repr__(self) -> str:
        slab = "" if self.slab_mm is None else f" of {self.slab_mm:g} mm"
        prior = "none" if self.prior_std_error is None else _display.estimate(self.prior, self.prior_std_error)
        return _display.short(
            self, f"{self.name}{slab}: {_display.estimate(self.value, self.std_error)}, prior {prior}"
        )


@dataclass(frozen=True)
class SourceShare:
    """Share of a source of error in the variances of ln σ_t, √(1 - α), ln σ_s(1 - g) and √σ_a; they sum to 1."""

    source: str
    """`noise`, `dictionary`, `thickness`, `origin`, `blur`, `gain`, `zero`, `slope`, `wedge`, `scale`,
    `other_channels`, `g`, `scene`."""
    sigma_t: float
    """Share of the variance of ln σ_t, 0 to 1."""
    albedo: float
    """Share of the variance of √(1 − α), 0 to 1."""
    reduced_scattering: float
    """Share of the variance of ln σ_s(1 − g), 0 to 1."""
    absorption: float
    """Share of the variance of √σ_a, 0 to 1."""
    quantity: str | None = None
    """The quantity of the scene, if the source is `scene`."""

    def __repr__(self) -> str:
        shares = (self.sigma_t, self.albedo, self.reduced_scattering, self.absorption)
        of_each = zip(("σ_t", "α", "σ_s(1−g)", "σ_a"), shares, strict=True)
        text = ", ".join(f"{name} {100 * share:.1f} %" for name, share in of_each)
        return _display.short(self, f"{self.quantity or self.source}: {text}")


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
    """The estimate, in the unit."""
    std_error: float
    """Its standard error, in the unit."""
    prior: float
    """The mean of the prior, in the unit."""
    prior_std_error: float
    """The standard error of the prior, in the unit."""
    at_end: bool
    """The data pull the estimate beyond the range of the dictionary's responses, where the true value may lie."""

    def __repr__(self) -> str:
        slab = "" if self.slab_mm is None else f" of {self.slab_mm:g} mm"
        value, prior = (
            _display.estimate(mean, std_error)
            for mean, std_error in ((self.value, self.std_error), (self.prior, self.prior_std_error))
        )
        return _display.short(
            self, f"{self.quantity}{slab} ({self.scope}): {value} {self.unit}".rstrip() + f", prior {prior}"
        )


@dataclass(frozen=True)
class Likelihood:
    """Results of the likelihood for a channel, in addition to its medium."""

    chi2: float
    """The sum of squared residuals over their variances, priors included."""
    degrees_of_freedom: float
    """The value of χ² that noise alone leads to on average."""
    probability: float
    """Probability of a χ² at least as large from noise alone."""
    nuisances: tuple[NuisanceEstimate, ...]
    """Estimates of the set-up."""
    outliers: int
    """Pixels that were given no weight."""
    budget: tuple[SourceShare, ...] = ()
    """Shares of the variances of the medium by source; empty if the data determine nothing."""
    scene: tuple[SceneEstimate, ...] = ()
    """Uncertain quantities of the scene; empty if it was taken as exact."""

    def __repr__(self) -> str:
        parts = [f"χ² {self.chi2:.0f} of {self.degrees_of_freedom:.0f}", f"p {_display.number(self.probability, 2)}"]
        parts += [
            f"{self.outliers} outliers",
            f"{len(self.nuisances)} nuisances",
            f"{len(self.budget)} sources of error",
        ]
        parts += [f"{len(self.scene)} quantities of the scene"] if self.scene else []
        return _display.short(self, ", ".join(parts))


# eq=False: the equality of arrays has no single truth value.
@dataclass(frozen=True, eq=False)
class Refined:
    """A continuous optimum, with error bars of 95 %."""

    medium: Medium
    """The optimum."""
    sigma_t_per_mm: Interval
    """Interval of the extinction coefficient, in 1/mm."""
    albedo: Interval
    """Interval of the single-scattering albedo."""
    g: Interval
    """Interval of the anisotropy, the mean cosine of the phase function."""
    reduced_scattering_per_mm: Interval
    """Interval of σ_s (1 − g), in 1/mm."""
    absorption_per_mm: Interval
    """Interval of σ_a, in 1/mm."""
    resolved: bool
    """Whether the data determine σ_t and the albedo: both intervals are bounded and narrow."""
    resolved_at_g: bool
    """Whether the data would determine them with g held at its best value; if this alone is true, g is open."""
    valley: bool
    """σ_t and g trade off along media that are equivalent by similarity theory."""
    misfit: float
    """Root mean square of the residuals over the noise: 1 if noise alone explains them."""
    error: float
    """The minimised objective."""
    covariance: Array = field(repr=False)
    """Covariance, of the shape (3, 3), of (ln σ_t, √(1 − α), ln(1 − g)); zeros where a parameter was held."""
    likelihood: Likelihood = field(repr=False)
    """χ², estimates of the set-up, and the error budget."""
    suspicion: str | None = None
    """The most likely single cause of a misfit beyond noise."""
    second_lobe: SecondLobe | None = None
    """The second lobe of the phase function, at its estimate; None if the function has none. `likelihood.scene` has
    the standard errors of what was estimated, with the priors."""
    converged: bool = True
    """Whether the descent ended at a minimum; if not, neither the medium nor its intervals hold."""

    def __repr__(self) -> str:
        return _display.short(self, self._summary())

    def _summary(self) -> str:
        m = self.medium
        values = (
            f"σ_t {_display.number(m.sigma_t_per_mm)} ({self.sigma_t_per_mm}) /mm",
            f"α {_display.albedo(m.albedo)} ({self.albedo})",
            f"g {_display.number(m.g)} ({self.g})",
            f"misfit {self.misfit:.1f}",
        )
        return ", ".join(values) + ("" if self.resolved_at_g else "; unresolved")


@dataclass(frozen=True, eq=False)
class Curves:
    """The compared profiles at one thickness."""

    thickness_mm: float
    """The slab's thickness, in mm."""
    x_mm: Array
    """Centres of the pixels, in mm."""
    measured: Array
    """Measured values times μ, on the dictionary's pixels."""
    best_record: Array
    """The profile of the best record."""
    refined: Array | None
    """The profile of the continuous optimum; None without one."""
    residuals: Array | None = None
    """Measured less refined values over their standard errors; None without likelihood."""
    left_out: Array | None = None
    """Indices of pixels that the likelihood leaves out, such as dust."""

    def __repr__(self) -> str:
        fitted = "best record" if self.refined is None else "best record and continuous optimum"
        return _display.short(self, f"{self.thickness_mm:g} mm: {self.x_mm.size} pixels, {fitted}")


@dataclass(frozen=True)
class ChannelFit:
    """One channel of a material."""

    channel: str
    """The channel's name."""
    candidates: tuple[Candidate, ...]
    """The best records, the best one first; `top` is their number."""
    refined: Refined | None
    """The continuous optimum; None without `refine`."""
    outside: str | None
    """`brighter` or `darker`, if a profile's mean lies beyond that of every record."""
    curves: tuple[Curves, ...] = field(default=(), repr=False)
    """The compared profiles, one for each thickness; empty unless `curves=True`."""

    def __repr__(self) -> str:
        text = self.refined._summary() if self.refined else f"{self.medium}; best of {len(self.candidates)} records"
        return _display.short(self, f"{self.channel}: {text}")

    @property
    def medium(self) -> Medium:
        """The continuous optimum; without one the best record's medium."""
        return self.refined.medium if self.refined else self.candidates[0].medium

    @property
    def second_lobe(self) -> SecondLobe | None:
        """The second lobe of the continuous optimum's phase function; None if the function has none, and without an
        optimum."""
        return self.refined.second_lobe if self.refined else None
