"""What two processes tell each other, however much it is."""

import threading
from multiprocessing import Pipe

import pytest
import torch

from torchhand.track.messages import answering, packed

LARGE = torch.zeros(4_000_000, dtype=torch.uint8)  # more than a connection holds


def test_orders_and_answers_that_a_connection_does_not_hold_pass_each_other() -> None:
    """Both ends send before either reads."""
    ours, theirs = Pipe()
    received: list[int] = []
    has_answered = threading.Event()

    def answer() -> None:
        with answering(theirs) as send:
            send(LARGE)
            has_answered.set()
            received.append(len(theirs.recv_bytes()))

    def order() -> None:
        has_answered.wait()
        ours.send_bytes(packed(LARGE))
        received.append(len(ours.recv_bytes()))

    both = [threading.Thread(target=one, daemon=True) for one in (answer, order)]
    for one in both:
        one.start()
    for one in both:
        one.join(timeout=60)
    assert received == [len(packed(LARGE))] * 2


def test_answers_come_in_order_and_an_error_comes_after_them() -> None:
    ours, theirs = Pipe()

    def fail() -> None:
        with answering(theirs) as send:
            for number in range(3):
                send(torch.tensor(number))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    theirs.send_bytes(b"error")
    got = [ours.recv_bytes() for _ in range(4)]
    assert got == [*(packed(torch.tensor(number)) for number in range(3)), b"error"]


def test_nobody_at_the_other_end_ends_it() -> None:
    ours, theirs = Pipe()
    ours.close()
    with answering(theirs) as send:
        send(LARGE)
        send(LARGE)
