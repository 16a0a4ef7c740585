"""Draws from the posterior of phantoms, by sequential Monte Carlo from the generator's own draws.

Particles are phantoms of all families. They begin as draws of the prior p (`prior`), and are taken
to the posterior, given a frame, through

    p L_b,    b from 0 to 1,

with L_b the power b of the likelihood by the stand-in of the exact model (`models`), whose errors
keep their size (annealed sequential Monte Carlo: Del Moral, Doucet and Jasra 2006, 3.3). A step
raises b by as much as leaves the share `ENOUGH` of the particles of every likely family effective,
draws them anew by their weights, and moves each within its family (`moves`). As particles close in,
the stand-in is fitted anew to exact solutions of some of them; what that changes is part of the
weights. A family has `PARTICLES` for each term of its emulator until it is given up; the products
of their mean weights are its evidence, which says how likely it is. At b = 1 it is found anew by
importance sampling about the particles (`moves.Moves.scattered`).

In the end, `CHECKED` of the particles are solved exactly, and after further moves as many again,
until their weights, the exact likelihood over that of the stand-in, leave enough of them: these are
the draws. Where `BATCHES` of them would not do, for the frame tells the stand-in's errors from
noise, particles go on by exact solutions alone: the errors stay noise at first, and become smaller
step by step until there are none. Weights cannot tell of a family or a mode that was lost on the
way: only another run or sampler can (`merged`), or a phantom that explains the frame better
(`importance`).

Two kinds of proposals make two samplers, see `moves`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import optimize, special

from eitbench.benchmark.ceiling.frames import Errors, Frame
from eitbench.benchmark.ceiling.models import PhantomModels, StandIn
from eitbench.benchmark.ceiling.moves import Moves, Proposals
from eitbench.benchmark.ceiling.prior import FamilyPrior
from eitbench.methods.shapes.posterior import ACCEPTED, ENOUGH, resampled
from eitbench.scenarios.arrays import Array, Index, Mask

PARTICLES, LIBRARY = 14, 5
"""Particles of a family, for each term of its emulator, whose number grows as the square of that of
parameters; and draws of the prior, for each particle, that they begin from."""
CHAINS = (4, 24)
"""Steps of the chains, by the emulator, at whose ends the moves of a particle in a step aim."""
LIKELY, UNLIKELY = 1e-3, 1e-6
"""Probability of a family from which on steps wait for it, and below which it is given up."""
CLOSER = 6.0
"""Rise of b after which the stand-in is fitted anew."""
SOLVED, SOLVED_LAST = 32, 50
"""Exact solutions that it is fitted to on the way, and at b = 1."""
KEPT, FALL, FALLS = 0.3, 0.7, 12
"""Effective share that a fit leaves, or b falls by this factor, so often at most."""
SETTLED, FALLING, FITS, RECENT = 0.5, 0.8, 12, 3
"""Effective share that a fit at b = 1 leaves when it is the last one; its errors over those of the
fit before, below which another one follows; the most such fits; and the solutions of how many of
them a fit is to."""
CHECKED, BATCHES, AIMED = 200, 5, 1.0
"""Particles that are solved exactly at once in the end, how often at most, and the effective number
of their weights, over `CHECKED`, from which on they are the draws."""
FEW, STIRRED, AT_LAST = 4, 4, 8
"""Particles that go on by exact solutions, for each term of an emulator, but at least `CHECKED`;
how often they are moved at most in a step, until the share `ENOUGH` of them differ; and how often
after the last step."""
CORRECTED = 0.3
"""`Draws.effective` from which on draws are taken for exact."""
SCATTERED, TOLD = 4000, 0.02
"""Vectors of a family that tell its evidence, and the effective share of them from which on they
do."""
LOST = 1e-3
"""Evidence of a run over the greatest one, below which it does not count."""
LEAST = 1e-12
"""Of b, in the search for the first one, and of what is left of errors over what there was."""


class Particles(NamedTuple):
    """Phantoms.

    Attributes:
        families: (n,) numbers of their families.
        vectors: (n, P) parameters, filled up with zeros.
        predicted: (n, K) by the quick model, or by the exact one in the end [V/A].
    """

    families: Index
    vectors: Array
    predicted: Array

    def take(self, chosen: Index) -> Particles:
        """The particles of these numbers."""
        return Particles._make(values[chosen] for values in self)

    @classmethod
    def joined(cls, parts: Sequence[Particles]) -> Particles:
        """The particles of all parts."""
        return cls._make(map(np.concatenate, zip(*parts, strict=True)))

    def where(self, chosen: Mask, other: Particles) -> Particles:
        """These particles, or those of `other` where `chosen` (n,) is true."""
        pairs = zip(other, self, strict=True)
        return Particles._make(
            np.where(chosen.reshape(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs
        )


class Draws(NamedTuple):
    """Weighted draws of the posterior.

    Attributes:
        families, vectors: as of `Particles`.
        weights: (n,), which sum to 1.
        log_likelihoods: (n,) exact ones, see `Frame`.
        effective: how many particles exact weights leave effective, or how many differ where they
            went on by exact solutions, over `CHECKED`; below `CORRECTED` they are not taken for
            exact.
        log_evidence: logarithm of the exact likelihood's mean over the prior, but for a constant of
            the frame; a rough one where the draws are not exact.
    """

    families: Index
    vectors: Array
    weights: Array
    log_likelihoods: Array
    effective: float
    log_evidence: float


def merged(runs: Sequence[Draws]) -> Draws:
    """The draws of several runs of a sampler together, of which the exact ones count, if any.

    Exact draws weigh as the evidence of their run, which is a mean over all that it saw (Del Moral,
    Doucet and Jasra 2006, 3.2): a run that lost what is likely has a small one. Where draws are not
    exact their evidence is rough: it tells which runs have `LOST` what is likely, and the others
    weigh alike.
    """
    most = max(run.log_evidence for run in runs)
    found = [run for run in runs if run.log_evidence > most + math.log(LOST)]
    exact = [run for run in found if run.effective >= CORRECTED]
    some = exact or found
    shares = special.softmax([run.log_evidence if exact else 0.0 for run in some])
    families, vectors, weights, log_likelihoods = (
        [run[field] for run in some] for field in range(4)
    )
    return Draws(
        np.concatenate(families),
        np.concatenate(vectors),
        np.concatenate([share * of for share, of in zip(shares, weights, strict=True)]),
        np.concatenate(log_likelihoods),
        max(run.effective for run in some),
        float(special.logsumexp([run.log_evidence for run in some]) - math.log(len(some))),
    )


def library(models: PhantomModels, rng: np.random.Generator) -> Particles:
    """Draws of the prior, `LIBRARY` of every family for each of its particles."""
    drawn = [prior.draw(LIBRARY * _particles(prior), rng) for prior in models.priors]
    longest = max(vectors.shape[1] for vectors in drawn)
    families = np.repeat(np.arange(len(drawn)), [len(vectors) for vectors in drawn])
    vectors = np.concatenate([np.pad(v, ((0, 0), (0, longest - v.shape[1]))) for v in drawn])
    return Particles(families, vectors, models.quick(families, vectors))


def _particles(prior: FamilyPrior) -> int:
    """Particles of a family."""
    return PARTICLES * _terms(prior)


def _few(prior: FamilyPrior) -> int:
    """Particles of a family that go on by exact solutions."""
    return max(CHECKED, FEW * _terms(prior))


def _terms(prior: FamilyPrior) -> int:
    """Terms of the emulator of a family."""
    return math.comb(len(prior.parameters.low) + 2, 2)


@dataclass(frozen=True, eq=False)
class Sampler:
    """Sampling of posteriors.

    Attributes:
        models: of the unit that frames come from.
        library: draws of the prior.
        proposals: see `moves`.
    """

    models: PhantomModels
    library: Particles
    proposals: Proposals

    def draws(self, frame: Frame, rng: np.random.Generator) -> Draws:
        """Draws of the posterior, given a frame."""
        annealing = _Annealing(self, frame, rng)
        annealing.run()
        return annealing.draws()


def _nothing(predicted: Array) -> Array:
    """The stand-in of exact predictions (n, K) [V/A]: they need none."""
    return predicted


class _Annealing:
    """The particles of one frame on their way from the prior to the posterior."""

    def __init__(self, sampler: Sampler, frame: Frame, rng: np.random.Generator) -> None:
        self._models, self._proposals = sampler.models, sampler.proposals
        self._particles, self._frame, self._rng = sampler.library, frame, rng
        self._predict, self._count = self._models.quick, _particles
        self._use(self._models.untouched())
        self._log_likely = np.log([prior.share for prior in self._models.priors])
        self._sharpness, self._stride, self._log_evidence = 0.0, 1.0, 0.0
        self._solved: list[tuple[Array, Array]] = []

    def _use(self, stand_in: StandIn) -> None:
        self._stand_in: Callable[[Array], Array] = stand_in
        self._errors = stand_in.errors_in(self._frame)

    def _log_likelihood(self, particles: Particles, sharpness: float | None = None) -> Array:
        """log L_b (n,) of particles; b is that of now by default."""
        b = self._sharpness if sharpness is None else sharpness
        predicted = self._stand_in(particles.predicted)
        return self._frame.log_likelihood(predicted, b, self._errors)

    def _of(self, least: float) -> dict[int, Index]:
        """The numbers of the particles of each family that is at least so likely."""
        families = self._particles.families
        likely = np.flatnonzero(self._log_likely >= math.log(least))
        return {family: np.flatnonzero(families == family) for family in likely.tolist()}

    def run(self) -> None:
        """Take the particles to p L_1."""
        self._sharpen(1 / LIBRARY)
        fitted_at, fits, share, falling = self._sharpness, 0, 0.0, True
        while fits < FITS and (self._sharpness < 1 or share < SETTLED or falling):
            self._move()
            if self._sharpness < 1:
                self._sharpen(ENOUGH)
            last = self._sharpness == 1
            if last or self._sharpness > CLOSER * fitted_at:
                fitted_at = self._sharpness
                before = self._errors.variances.sum()
                share = self._fit(SOLVED_LAST if last else SOLVED)
                falling = bool(self._errors.variances.sum() < FALLING * before)
                fits += last
        while self._sharpness < 1:
            self._move()
            self._sharpen(ENOUGH)
        self._move()
        self._scatter()
        self._move()

    def _scatter(self) -> None:
        """Find the evidence of families anew, by importance sampling about their particles.

        Particles are drawn anew of these vectors. This takes out the errors that many steps leave
        in the evidence, and in the shares of the modes of a family.
        """
        evidence, parts = self._log_evidence + self._log_likely, []
        for family, (of, moves) in self._moves().items():
            prior = self._models.priors[family]
            vectors, log_weights = moves.scattered(SCATTERED, self._rng)
            families, missing = np.full(len(vectors), family), self._particles.vectors.shape[1]
            padded = np.pad(vectors, ((0, 0), (0, missing - vectors.shape[1])))
            scattered = Particles(families, padded, self._predict(families, padded))
            log_weights += self._log_likelihood(scattered)
            if not len(vectors) or effective(log_weights) < TOLD * SCATTERED:
                parts.append(self._particles.take(of))
                continue
            total = float(special.logsumexp(log_weights))
            evidence[family] = math.log(prior.share) + total - math.log(SCATTERED)
            chosen = resampled(special.softmax(log_weights), _particles(prior), self._rng)
            parts.append(scattered.take(chosen))
        self._particles = Particles.joined(parts)
        self._log_evidence = float(special.logsumexp(evidence))
        self._log_likely = evidence - self._log_evidence

    def _moves(self) -> dict[int, tuple[Index, Moves]]:
        """The numbers of the particles of each family, and their moves."""
        predictions, found = self._stand_in(self._particles.predicted), {}
        for family, of in self._of(UNLIKELY).items():
            prior = self._models.priors[family]
            vectors = self._particles.vectors[of, : len(prior.parameters.low)]
            found[family] = of, Moves.about(prior, vectors, predictions[of])
        return found

    def _sharpen(self, enough: float) -> None:
        """Raise b, so that this share of every likely family stays effective."""
        now = self._log_likelihood(self._particles)

        def gain(b: float) -> Array:
            return self._log_likelihood(self._particles, b) - now

        b = math.exp(self._nearest(0.0, math.log(max(self._sharpness, LEAST)), gain, enough))
        self._draw_anew(gain(b))
        self._sharpness = b

    def _nearest(
        self, aim: float, begin: float, gain: Callable[[float], Array], enough: float
    ) -> float:
        """The number from `begin` to `aim` that is nearest to the aim and leaves enough particles.

        Args:
            aim, begin: logarithms of values.
            gain: what the logarithms (n,) of the particles' weights change by at a value.
            enough: share of the particles of every likely family that stays effective.
        """
        of = self._of(LIKELY).values()

        def surplus(log_value: float) -> float:
            gained = gain(math.exp(log_value))
            return min(effective(gained[some]) / len(some) for some in of) - enough

        if surplus(aim) >= 0:
            return aim
        return float(optimize.brentq(surplus, min(aim, begin), max(aim, begin), xtol=0.02))

    def _fit(self, count: int) -> float:
        """Fit the stand-in anew, to exact solutions of so many particles.

        Half of them are chosen as likely as their families are. At b = 1, those of the fits before
        count, too. Where particles were led astray, b falls until enough of every likely family are
        effective.
        Returns the least share of a likely family that would be effective at the same b.
        """
        chances = (self._even() + 1 / len(self._particles.families)) / 2
        some = resampled(chances, count, self._rng)
        chosen = self._particles.take(some)
        exact = self._models.exact(chosen.families, chosen.vectors)
        before = self._log_likelihood(self._particles)
        pairs = [(chosen.predicted, exact)]
        if self._sharpness == 1:
            pairs = self._solved = [*self._solved[1 - RECENT :], *pairs]
        self._use(StandIn.fitted(*map(np.concatenate, zip(*pairs, strict=True))))
        of = self._of(LIKELY).values()
        powers = self._sharpness * FALL ** np.arange(FALLS)
        changes = [self._log_likelihood(self._particles, b) - before for b in powers]
        shares = [min(effective(c[some]) / len(some) for some in of) for c in changes]
        k = next((k for k, share in enumerate(shares) if share > KEPT), int(np.argmax(shares)))
        change, self._sharpness = changes[k], powers[k]
        self._draw_anew(change)
        return shares[0]

    def _draw_anew(self, log_weights: Array, least: float = UNLIKELY) -> None:
        """Draw particles by their weights, of each family as many as it is to have.

        Families that are less than `least` likely are given up. The mean weights are what the
        families become more or less likely by, and the evidence.
        """
        of = self._of(UNLIKELY)
        for family, some in of.items():
            mean = special.logsumexp(log_weights[some]) - math.log(len(some))
            self._log_likely[family] += float(mean)
        risen = float(special.logsumexp(self._log_likely))
        self._log_likely -= risen
        self._log_evidence += risen
        left = {family: some for family, some in of.items() if family in self._of(least)}
        self._log_likely[[k not in left for k in range(len(self._log_likely))]] = -np.inf
        chosen = []
        for family, some in left.items():
            count, weights = self._count(self._models.priors[family]), log_weights[some]
            chosen.append(some[resampled(special.softmax(weights), count, self._rng)])
        self._particles = self._particles.take(np.concatenate(chosen))

    def draws(self) -> Draws:
        """The draws, by exact weights where these leave enough of them.

        Particles are checked, and moved and checked again, until as many are effective as is aimed
        at. Where it is hopeless that enough will be, they go on to the exact posterior themselves.
        """
        checked, log_weights, log_likelihoods = [], [], []
        for batches in range(1, BATCHES + 1):
            chosen = self._particles.take(resampled(self._even(), CHECKED, self._rng))
            exact = self._models.exact(chosen.families, chosen.vectors)
            checked.append(chosen)
            log_likelihoods.append(self._frame.log_likelihood(exact))
            log_weights.append(log_likelihoods[-1] - self._log_likelihood(chosen))
            weights = np.concatenate(log_weights)
            share = effective(weights) / CHECKED
            if share >= AIMED:
                break
            if share / batches * BATCHES < AIMED:
                return self._finished()
            self._move()
        families, vectors, _ = Particles.joined(checked)
        evidence = self._log_evidence + float(special.logsumexp(weights)) - math.log(len(weights))
        weights, fits = special.softmax(weights), np.concatenate(log_likelihoods)
        return Draws(families, vectors, weights, fits, share, evidence)

    def _finished(self) -> Draws:
        """The draws, after particles have gone to the exact posterior by exact solutions.

        The errors of the stand-in are noise of exact predictions, too, but less with each step.
        """
        before, whole, left = self._log_likelihood(self._particles), self._errors, 1.0
        self._predict, self._count = self._models.exact, _few
        families, vectors, _ = self._particles
        self._particles = Particles(families, vectors, self._predict(families, vectors))
        self._stand_in = _nothing
        self._draw_anew(self._log_likelihood(self._particles) - before, LIKELY)
        while left > 0:
            self._stir()
            left = self._less(whole, left)
        return self._last()

    def _last(self) -> Draws:
        """The draws of particles at the exact posterior, as they move on."""
        self._stir()
        different = len(np.unique(self._particles.vectors, axis=0)) / CHECKED
        parts = [self._particles]
        for _ in range(AT_LAST):
            self._move(CHAINS[-1:])
            parts.append(self._particles)
        families, vectors, predicted = Particles.joined(parts)
        weights = np.tile(self._even() / len(parts), len(parts))
        fits = self._frame.log_likelihood(predicted)
        return Draws(families, vectors, weights, fits, different, self._log_evidence)

    def _stir(self) -> None:
        """Move the particles until enough of them differ."""
        for _ in range(STIRRED):
            self._move(CHAINS[-1:])
            vectors = self._particles.vectors
            if len(np.unique(vectors, axis=0)) >= ENOUGH * len(vectors):
                break

    def _less(self, whole: Errors, left: float) -> float:
        """Make the noise by errors less than this part of the `whole`; return what is left of it.

        By so much that every likely family stays effective.
        """
        now, predicted = self._log_likelihood(self._particles), self._particles.predicted

        def gain(part: float) -> Array:
            return self._frame.log_likelihood(predicted, 1.0, whole.part(part)) - now

        most = math.log(left)
        nearest = self._nearest(most + math.log(LEAST), most, gain, ENOUGH)
        part = math.exp(nearest) if nearest > most + math.log(LEAST) else 0.0
        self._draw_anew(gain(part), LIKELY)
        self._errors = whole.part(part)
        return part

    def _even(self) -> Array:
        """Weights (n,) of the particles by which each family counts as it is likely."""
        weights = np.zeros(len(self._particles.families))
        for family, some in self._of(UNLIKELY).items():
            weights[some] = math.exp(self._log_likely[family]) / len(some)
        return np.asarray(weights / weights.sum())

    def _move(self, chains: Sequence[int] = CHAINS) -> None:
        """Metropolis steps of every particle, one for each of the `chains`.

        A step goes to the end of a chain of steps by the emulator alone. This chain is reversible
        with respect to the prior times the emulator's likelihood, so that its end is accepted by
        what the likelihood rises more than the emulator's does (surrogate transition: Liu, Monte
        Carlo Strategies in Scientific Computing, 2001, 9.4.3).
        """
        families = list(self._moves().values())
        for length in chains:
            now = self._particles
            other, risen = self._ahead(families, length)
            gain = self._log_likelihood(other) - self._log_likelihood(now) - risen
            accepted = np.log(self._rng.random(len(gain))) < gain
            self._particles = now.where(accepted, other)

    def _ahead(self, families: list[tuple[Index, Moves]], length: int) -> tuple[Particles, Array]:
        """Where chains of so many steps lead, and by how much the emulator's log L_b rises there.

        Args:
            families: numbers of the particles of each family, and their moves.
            length: of the chains.
        """

        def log_likelihood(predictions: Array) -> Array:
            return self._frame.log_likelihood(predictions, self._sharpness, self._errors)

        other = Particles._make(values.copy() for values in self._particles)
        risen, taken = np.zeros(len(other.families)), []
        moved = np.zeros(len(other.families), dtype=bool)
        for of, moves in families:
            width = len(moves.centre)
            state = begin = moves.state(other.vectors[of, :width], log_likelihood)
            for _ in range(length):
                state, share = moves.moved(
                    state, self._stride, log_likelihood, self._proposals, self._rng
                )
                taken.append(share)
            other.vectors[of, :width] = state.vectors
            risen[of] = state.log_likelihood - begin.log_likelihood
            moved[of] = (state.vectors != begin.vectors).any(axis=1)
        other.predicted[moved] = self._predict(other.families[moved], other.vectors[moved])
        self._stride = min(self._stride * math.exp(float(np.mean(taken)) - ACCEPTED), 1.0)
        return other, risen


def effective(log_weights: Array) -> float:
    """Number of equal weights that weights of these logarithms (n,) are worth."""
    weights = special.softmax(log_weights)
    return float(1 / (weights @ weights))
