"""The same bits wherever arrays lie in memory: no kernel has two ways that round differently, and chooses by addresses."""

import numpy as np

from magmpm.compiled.jit import compiled


@compiled
def _shares(whole, of, to, first):
    """A quotient that the compiler would take in lanes as products, where `to` lies apart from the rest."""
    for k in range(len(of)):
        to[first + k] = of[k] / whole[0]


def test_the_same_bits_wherever_arrays_lie() -> None:
    """Side by side, and one after the other in one piece of memory, whose ends the compiler can't tell from an overlap."""
    of = np.random.default_rng(1).random(81)
    whole = np.array([0.7])
    apart = np.empty(1000)
    _shares(whole, of, apart, 0)
    together = np.empty(1000)
    together[81:162] = of
    together[162] = whole[0]
    _shares(together[162:163], together[81:162], together[:81], 0)
    np.testing.assert_array_equal(together[:81], apart[:81])


def test_kernels_do_not_ask_where_arrays_lie() -> None:
    """What LLVM names the comparison of addresses before a loop in lanes."""
    _shares(np.ones(1), np.ones(3), np.empty(3), 0)
    (text,) = _shares.inspect_llvm().values()
    assert "fdiv" in text
    assert "conflict" not in text
    assert "memcheck" not in text
