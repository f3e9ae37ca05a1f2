"""Links that alone hold a part of a graph: found as by leaving each out."""

from hypothesis import given
from hypothesis import strategies as st

from torchreg.site.bridges import bridges


def component(links, start):
    reached, left = {start}, [start]
    while left:
        node = left.pop()
        for one, other in links:
            for near, far in ((one, other), (other, one)):
                if near == node and far not in reached:
                    reached.add(far)
                    left.append(far)
    return reached


@given(st.lists(st.tuples(st.integers(0, 11), st.integers(0, 11)).filter(lambda link: link[0] != link[1]), max_size=25))
def test_a_bridge_is_a_link_without_which_its_ends_do_not_connect(links):
    found = {bridge.number: bridge.smaller for bridge in bridges(links, 12)}
    for number, (one, other) in enumerate(links):
        rest = links[:number] + links[number + 1 :]
        sides = component(rest, one), component(rest, other)
        assert (number in found) == (other not in sides[0])
        if number in found:
            assert found[number] in sides
            assert len(found[number]) == min(map(len, sides))


def test_a_long_chain_needs_no_deep_recursion():
    chain = [(k, k + 1) for k in range(5000)]
    assert len(bridges(chain, 5001)) == 5000
