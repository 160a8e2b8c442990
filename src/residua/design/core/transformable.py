"""What every residual generator can be turned into: parity relations, other poles, another generator."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from residua.design.core.generator import ResidualGenerator
    from residua.design.parity.equivalence import Equivalence
    from residua.design.parity.relations import ParityRelations, Poles


class Transformable:
    """The transformations of Gertler's equivalence, which every residual generator has."""

    @property
    def _generator(self) -> ResidualGenerator:
        return cast("ResidualGenerator", self)

    def to_parity(self) -> ParityRelations:
        r"""Return the parity relations behind the residuals: the same equations without poles.

        Each residual is :math:`r = r^* c(z) / d(z)` with a relation :math:`r^*` that is polynomial in inputs and
        outputs; a factor ``c`` that all signals share is divided out, and told in ``divided``.

        Returns
        -------
        ParityRelations

        Raises
        ------
        AccuracyError
            If a residual is no exact relation, such as that of a sampled continuous design, or the polynomials lose
            too many digits.
        DesignError
            If the plant has an ``E`` and the generator no state map.

        References
        ----------
        Gertler (1991), eqs. (3-18) to (3-23).

        Examples
        --------
        >>> import residua as rs
        >>> flt = rs.design.decoupled_residual(rs.library.gertler(), insensitive_to="p1", poles=[0.25, 0.3])
        >>> flt.to_parity().orders
        (2,)
        """
        # here, for these modules need the generator's
        from residua.design.parity.conversion import to_parity

        return to_parity(self._generator)

    def with_poles(self, poles: Poles | None = None) -> ResidualGenerator:
        """Return the generator of the same relations with other poles; see :meth:`ParityRelations.with_poles`.

        Parameters
        ----------
        poles : sequence of complex, or mapping of str to sequence, optional
            As many as the order of each relation; all zero in sampled time when omitted (the moving-average form).

        Returns
        -------
        ResidualGenerator

        Raises
        ------
        DesignError
            If the poles do not fit.
        AccuracyError
            As for :meth:`to_parity`.

        References
        ----------
        Gertler (1991), section 3.5.
        """
        made = self.to_parity().with_poles(poles)
        generator = self._generator
        old = generator.evidence
        evidence = made.evidence.extended(
            ranks=dict(old.ranks), references=tuple({*made.evidence.references, *old.references})
        )
        kept = [note for note in old.notes if generator.relations is not None and "digits" not in note]
        evidence = replace(evidence, notes=tuple(dict.fromkeys([*kept, *made.evidence.notes])))
        return replace(
            made, method=generator.method, evidence=evidence, codes=generator.codes, members=generator.members
        )

    def equivalent_to(self, other: ResidualGenerator) -> Equivalence:
        """Tell whether another generator is the same up to poles and scale, or another transformation, and which.

        Parameters
        ----------
        other : ResidualGenerator
            Of a plant with as many inputs and outputs, and of the same step.

        Returns
        -------
        Equivalence
            True when equivalent; prints the transformation from this generator to the other.

        Raises
        ------
        ModelError
            If the two take different signals.

        References
        ----------
        Gertler (1991), section 3.5: every residual generator is a transformation of the primary residuals.

        Examples
        --------
        >>> import residua as rs
        >>> plant = rs.library.gertler()
        >>> a = rs.design.decoupled_residual(plant, insensitive_to="p1", poles=[0.25, 0.3])
        >>> b = rs.design.parity_relations(plant, insensitive_to="p1")
        >>> print(b.equivalent_to(a))
        equivalent: the same up to poles and scale (to ...)
          r1 = ... x zeros at 0, 0 / poles at 0.3, 0.25 of r1
        """
        # here, for these modules need the generator's
        from residua.design.parity.equivalence import equivalence

        return equivalence(self._generator, other)
