import signal

import pytest

from psmpc_cli.cli.termination import noticing_signals


@pytest.mark.parametrize(
    ("number", "code", "reason"), [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "terminated")]
)
def test_a_signal_is_only_noted_and_the_next_one_has_its_usual_effect(
    number: signal.Signals, code: int, reason: str
) -> None:
    before = {each: signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)}
    with noticing_signals() as interruption:
        interruption.check()
        signal.raise_signal(number)
        assert interruption.exit_code == code
        assert {signal.getsignal(each) for each in before} == {signal.SIG_DFL}
        with pytest.raises(KeyboardInterrupt, match=reason):
            interruption.check()
    assert {each: signal.getsignal(each) for each in before} == before
