"""Plants of the campaign that once had a wrong answer, or one that changed with units, by what was wrong."""

from __future__ import annotations

import pytest

from exact_campaign import designs, examination
from exact_campaign.analyses import analyses
from exact_campaign.answers import FAILURES

EARLIER = [
    # a fault that crosses parts of a plant without a common unit was taken for rounding
    ("no states", 1, designs._filters),
    # the reading of a fault kept what rounding left of an output that it does not read
    ("no states", 3, designs._estimators),
    # parts of a plant without a common unit were compared in units of signals, and mixed where they were equal
    ("no states", 2, designs._parity),
    ("no states", 20000, designs._parity),
    ("no states", 20003, designs._parity),
    ("dead sensors", 602, designs._parity),
    ("dead sensors", 20007, designs._parity),
    ("hidden modes", 20006, designs._parity),
    # a zero at 0 of multiplicity two was scattered
    ("delays", 301, None),
    ("integrators", 20008, None),
    # algebraic equations were counted twice
    ("singular E", 20000, None),
    # sizes of polynomials on poles that meet came of the scatter of these
    ("repeated poles", 20001, designs._parity),
    ("repeated poles", 20008, designs._parity),
    # the size of polynomials on one pole came of what rounding of the pole leaves on the diagonal
    ("repeated poles", 19, designs._parity),
    ("repeated poles", 41, designs._parity),
    # a direction of a response was taken for rounding because residuals have other units
    ("planted zeros", 20007, designs._filters),
    ("alike directions", 20011, designs._filters),
    ("stiff", 20012, designs._filters),
    ("used-up measurements", 602, designs._filters),
    ("alike directions", 20008, designs._scheme_banks),
    # states were read through what rounding left of nothing
    ("singular E", 2, designs._decoupled),
    ("singular E", 20012, designs._decoupled),
    # states that no input reaches were judged in units of the caller
    ("sparse", 20002, designs._perfect),
    ("feedthrough", 20014, designs._perfect),
    # equal sensors leave a combination of rows that reads nothing, which was divided by its size
    ("duplicated sensors", 59, designs._perfect),
    # what rounding left of a fault of a sensor among the events was a coupling
    ("used-up measurements", 16, designs._filters),
    # polynomials of relations had sizes in the units of the caller
    ("dead sensors", 136, designs._parity),
    # outputs that no fault connects, but a disturbance does, had no common unit
    ("no states", 324, designs._observers),
    ("stiff", 324, designs._observers),
    # a control that enters nothing did so by what rounding left of a pseudo-inverse, and leaked by all of it
    ("singular E", 319, designs._observers),
    # the reading of a fault kept outputs by what rounding left of singular vectors
    ("no states", 315, designs._estimators),
    ("no states", 318, designs._estimators),
    # what rounding left of a fault in the internal form was a coupling by which units were chosen
    ("more outputs than states", 317, designs._estimators),
    # a state that no chain of equations couples with an input was reached by the rounding of pivoting
    ("singular E", 313, designs._perfect),
    # the inverse form was computed in units of the caller, for a pole whose inverse was the inverse of rounding
    ("feedthrough", 131, designs._estimators),
    # a combination of equally short relations kept what rounding left of outputs that cancel
    ("more outputs than states", 8, designs._parity),
    ("more outputs than states", 114, designs._parity),
    # the order that was asked for is another where floats in decimal units are another plant: a flaw of the campaign
    ("duplicated sensors", 309, designs._parity),
    # a dead sensor was read by random gains that change nothing, in whatever units it had
    ("dead sensors", 419, designs._perfect),
    # answers about two zeros were kept under one name: a flaw of the campaign
    ("sparse", 506, None),
    # a gain that rounding left in a row coupled its state with others, which a residual then heard
    ("alike directions", 504, designs._filters),
    # a zero at 0 was what rounding left of it, on the stable side: an observer that does not exist was designed
    ("stiff", 603, designs._observers),
    # a plant that integrates leaked below a hundredth of its slowest pole, where nothing was measured
    ("stiff", 712, designs._parity),
    ("stiff", 131, designs._filters),
    # a gain was measured in units of the plant, whose chains are far slower than the poles asked for
    ("stiff", 704, designs._scheme_banks),
    # what rounding of decimal units left of an input was compared with itself: a flaw of the campaign
    ("singular E", 714, designs._parity),
    # states that no output sees had units without end, in which a disturbance that moves them was rounding
    ("repeated poles", 1027, None),
    # a fault whose ways cancel was compared with its own rounding in the internal form
    ("repeated poles", 1012, designs._estimators),
    # of relations that are equally good, rounding chose
    ("hidden modes", 1028, designs._parity),
    # what rounding left of an equation that a disturbance takes away was scaled up to a measurement
    ("singular E", 1008, designs._observers),
    ("singular E", 1038, designs._observers),
    # a perfect observer hung chains of a part on to those of another, with which it had no common unit
    ("dead sensors", 1035, designs._perfect),
    # rows of residuals in small units were taken for zero beside one in large units
    ("feedthrough", 1041, designs._parity),
    # the output with coefficient one was chosen in the units of the caller, and rounding with it
    ("integrators", 1042, designs._parity),
    # an algebraic equation held a disturbance by what rounding left of it
    ("singular E", 1128, designs._estimators),
    # the internal form was compared with responses that elimination in the units of the caller had rounded
    ("stiff", 1144, designs._estimators),
    # a triangular matrix was singular in units of rows and columns
    ("integrators", 1129, designs._estimators),
    # a gain that rounding left on an output coupled states, and was the norm of all
    ("dead sensors", 1203, designs._filters),
    # residuals had the size of what an integrator makes them of, beside which their answers were no directions
    ("integrators", 1107, designs._noise),
    # a direction that rounding bends where nearly everything cancels: a flaw of the campaign
    ("integrators", 1110, designs._filters),
    # what rounding left of a gain on a dead sensor was a direction of its fault
    ("dead sensors", 1118, designs._noise),
    # parts that nothing but a fault connects had the units of the caller beside one another
    ("stiff", 1325, designs._filters),
    ("repeated poles", 1329, designs._filters),
    # a gain on an output that reads no state had the unit of that output in the size of the gain
    ("dead sensors", 3002, designs._filters),
    # an output that divides nothing out was read by what rounding left of the gain that does
    ("stiff", 2038, designs._decoupled),
    # a gain on a state without an equation of its own was rounding, and compared with itself
    ("integrators", 5071, designs._filters),
    # what rounding left in a row of a gain coupled its state with others
    ("delays", 5106, designs._filters),
    # and where columns of a gain cancel
    ("oscillators", 2101, designs._observers),
    # the size of a gain knew nothing of what it cancels, nor that rounding in its rows is no gain
    ("companion", 2208, designs._observers),
    ("delays", 2212, designs._filters),
    ("feedthrough", 2219, designs._filters),
    # what rounding left of a control in a filter was compared with itself: a flaw of the campaign
    ("alike directions", 2308, designs._observers),
    # a mean of logarithms rounded otherwise in other units, and the relation that was divided by it
    ("integrators", 2303, designs._parity),
    # rates stood beside numbers without one in the caller's unit of time
    ("oscillators", 703, designs._parity),
    ("integrators", 704, None),
    ("stiff", 703, designs._observers),
    # unknown inputs were compared by the largest entries of rows and columns, which three rounds do not even out
    ("stiff", 7002, designs._estimators),
    # a pole at 0 was what rounding left of it, and the size of the dynamics
    ("singular E", 7113, None),
    # a chain of integrators, which has no rate, was looked at near zero in another unit of time
    ("integrators", 30015, None),
    # rounding had grown by a weak coupling, and scattered two zeros at 0
    ("repeated poles", 13062, None),
    # the zeros of floats in decimal units came in another order than those of the case: a flaw of the campaign
    ("repeated poles", 13017, None),
    # leaks of a plant that integrates were looked for where nothing was measured: a flaw of the campaign
    ("integrators", 7020, designs._observers),
    # of parts that act on outputs only, one ran away in the sweeps, until the others were rounding beside it
    ("oscillators", 8014, None),
    # what rounding left of nothing when E was diagonalised was a coupling, in which a zero was lost
    ("singular E", 21039, None),
    # four fixed poles at 0 were scattered
    ("delays", 7061, None),
    ("integrators", 14038, None),
    ("integrators", 14080, None),
    # zeros and ranks of plants that integrate were computed in the caller's unit of time
    ("integrators", 7119, None),
    ("integrators", 7125, None),
    ("integrators", 13019, None),
    ("integrators", 13021, None),
    # the units of a state that only one output reads, and nothing moves, were without end
    ("stiff", 13064, designs.designs),
    # a reason of the inverse form depended on units
    ("repeated poles", 7140, designs._estimators),
    # what rounding left of couplings that cancel was a state that a residual needs
    ("repeated poles", 7040, designs._decoupled),
    # a rank at a point was decided in units of the system, in which rates over six decades are none
    ("stiff", 14066, None),
    ("integrators", 14024, None),
    ("integrators", 14065, None),
    ("integrators", 14083, None),
    ("hidden modes", 14046, None),
    # small rows of a basis in the units of the residuals had lost their digits beside large ones
    ("stiff", 41000, designs._filters),
    # the response was looked at for a zero where another has a pole
    ("stiff", 42002, designs._observers),
    # in the limit a state that one sensor alone reads had any unit beside the rest, and a constant fault of it none
    ("stiff", 14068, None),
    # what rounding left of a gain that divides out disturbances was a coupling of states
    ("singular E", 7097, designs._decoupled),
    # what rounding left of a free part of a decoupling was read, and compared with itself
    ("singular E", 8307, designs._scheme_banks),
    # what a projection left of a gain was read, and all that a residual read
    ("sparse", 16003, designs._scheme_banks),
    # a control whose ways cancel in the states of a filter was compared with the rounding of it: a flaw of the campaign
    ("singular E", 18022, designs._observers),
    # a gain that rounding left of no correlation was the only rate that a filter of delays had
    ("delays", 18011, designs._noise),
    # whether a coefficient of a derivative is rounding was decided in units of the caller
    ("sparse", 19027, designs._perfect),
    # balls of 200 bits held zero without being narrow, in a filter with states of far sizes: a flaw of the campaign
    ("companion", 25245, designs._parity),
    # outputs that an observer need not read were combined with what rounding left of a disturbed one
    ("no states", 25206, designs._observers),
    # gains that cancel, of outputs that hardly read a state, were what rounding of that state had left
    ("stiff", 25272, designs._observers),
    # outputs that nothing connects were mixed, and in other units one of them was rounding beside the others
    ("no states", 25327, designs._observers),
    # what rounding left of gains that do not reach the other states coupled these, and poles were placed through it
    ("delays", 25101, designs._filters),
    ("repeated poles", 25117, designs._filters),
    # of two residuals that any rotation of is as right, one read a sensor by 2e-12 that the other reads
    ("singular E", 25465, designs._scheme_banks),
    # an internal form in which large states cancel hid what a fault does: less than a billionth of its terms
    ("stiff", 29015, designs._scheme_banks),
    # rows were brought to length one in units of the caller, and the rest of the design rounded otherwise in each
    ("integrators", 29018, designs._filters),
    ("stiff", 29024, designs._filters),
    ("stiff", 29045, designs._filters),
    # an estimate was not compared with the state as far down as its plant integrates, nor frequency by frequency
    ("stiff", 29031, designs._observers),
    # what rounding left of a fault that no output sees was taken for what the internal form hid
    ("hidden modes", 30109, designs._decoupled),
    # what is left of a fault in the end was less than any limit above rounding
    ("stiff", 29120, None),
    # of two sensors of one state, one that is a billionth of it beside an input had its share of the gain
    ("stiff", 31164, designs._observers),
    # a relation that annihilates the states to rounding is shorter than the exact one
    # leaks were asked for ten thousand times beyond all poles: a flaw of the campaign
    ("stiff", 29039, designs._decoupled),
    # of equations that leave nothing of an input, rounding was left where they were measured
    ("singular E", 32185, designs._observers),
    # a combination of outputs without disturbances read one more, by rounding, and by it saw a mode
    ("stiff", 32206, designs._observers),
    # two integrators side by side make zeros of a filter as one chain of two does: a flaw of the campaign
    ("stiff", 32199, designs._scheme_banks),
    # a residual was marked for faults that are a trillionth of what it is made of, by gains far below all others
    ("stiff", 33809, designs._filters),
    # a gain on measurements that the estimate reproduces was rounding of the others of its row, large in other units
    ("singular E", 33875, designs._scheme_banks),
    # rates so far apart that what two states make of an output differed by less than rounding
    ("stiff", 34110, None),
    # the Riccati equation of a plant with a pole a thousand times faster than the others, seen through a chain
    ("stiff", 34073, designs._noise),
    # an internal form in which gains of 37,000 cancel hid the only fault of a filter
    ("dense", 36019, designs._filters),
    # the same as 34110, nearer to a zero, in decimal units
    ("stiff", 35139, None),
    # directions of a fault that moves residuals a millionth as far as others do were taken for rounding
    ("stiff", 37034, designs._filters),
    # a residual read an output that nothing reaches, whose unit was taken for that of the others
    ("no states", 38328, designs._filters),
    # a shorter relation leaves 1e-14 of the states, not nothing
    ("stiff", 40234, None),
    # no leak was measured into a residual of which eight digits of all that it reads cancel
    ("stiff", 40250, designs._filters),
    # a reduced observer read its state by what rounding left of a projection
    ("repeated poles", 50018, designs._observers),
    # a residual read a dead sensor by what rounding left of its injection
    ("dead sensors", 50071, designs._banks_of_rows),
    # the pencil at a point far beyond the rates of a system lost the other terms
    ("feedthrough", 50099, None),
    # noise in states was weighed beside noise in outputs in the unit of time of the caller
    ("stiff", 50023, designs._noise),
    # the campaign asked for estimates of faults of which no pole is free
    ("repeated poles", 50005, designs._estimators),
    ("singular E", 50039, designs._estimators),
    # and of estimates of as many faults as outputs, whose fixed poles are stable, that a residual stands beside them
    ("hidden modes", 51006, designs._estimators),
    ("oscillators", 52009, designs._estimators),
    # states of an estimator that cancel left of a fault that no output sees what rounding made of them
    ("hidden modes", 52008, designs._estimators),
    # a chain of integrators was looked at, and its filter given poles, at what rounding leaves of its poles at zero
    ("repeated poles", 52008, designs._filters),
    # a leak was judged by the largest response of an output at one frequency times that of the filter at another
    ("integrators", 52029, designs._parity),
    ("integrators", 61002, designs._filters),
    # the rows of a decoupled residual mixed a dead sensor with others, and its noise, of any size, with theirs
    ("dead sensors", 61002, designs._noise),
    # a plant had a pole where its perfect observer was checked
    ("repeated poles", 52015, designs._perfect),
    # of an observer without states the error of an identity was divided by the size of its terms, which was zero
    ("sparse", 52035, designs._estimators),
    # the basis of rows that pivots were chosen by was not orthonormal, and came of the units
    ("more outputs than states", 52003, designs._filters),
    # a residual read a sensor that a fault hides by what rounding left of the estimate
    ("singular E", 52006, designs._scheme_banks),
    # T was what rounding left of H times C, and scaled up
    ("stiff", 52002, designs._estimators),
    # a relation of one output of a stiff plant was said to be one order shorter than the shortest
    ("stiff", 31267, designs._parity),
    # a relation kept a state by what rounding left of a quotient, and a control reached it
    ("hidden modes", 52018, designs._parity),
    ("integrators", 52022, designs._parity),
    # relations that read outputs of one part kept what rounding left of the states of another, and were mixed
    ("dead sensors", 52020, designs._parity),
    # polynomials of a pair with one state had the size of what rounding left of its rate
    ("hidden modes", 61001, designs._parity),
]


@pytest.mark.parametrize(("kind", "seed", "stage"), EARLIER, ids=[f"{kind} {seed}" for kind, seed, _ in EARLIER])
def test_what_failed_before_holds(kind: str, seed: int, stage: examination.Stage | None) -> None:
    asked = (analyses,) if stage is None else (analyses, stage)
    found = [one for one in examination.examine(kind, seed, asked)[1] if one.outcome in FAILURES]
    assert [f"{one.units}: {one.function}: {one.text}\n{one.plant}" for one in found] == []
