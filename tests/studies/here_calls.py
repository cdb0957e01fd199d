"""Calls that make no processes."""

from collections.abc import Callable, Iterator, Sequence


class HereCalls:
    """Calls in this process, at most so many."""

    def __init__(self, most: int = 10**6) -> None:
        self.most = most

    def each(self, function: Callable, items: Sequence, *_: object) -> Iterator:
        for index, item in enumerate(items):
            if index == self.most:
                raise KeyboardInterrupt
            yield index, function(item)
