import threading

import torch

from uwaug._support.deterministic import reproducible


def test_threads_are_given_back_to_all() -> None:
    """Threads that enter while another is inside get back what there was before the first."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    first_in, may_leave, seen = threading.Event(), threading.Event(), []

    def hold() -> None:
        with reproducible():
            first_in.set()
            may_leave.wait(10)
        seen.append(torch.get_num_threads())

    def pass_through() -> None:
        first_in.wait(10)
        with reproducible():
            seen.append(-torch.get_num_threads())
        seen.append(torch.get_num_threads())
        may_leave.set()

    try:
        workers = [threading.Thread(target=hold), threading.Thread(target=pass_through)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        later: list[int] = []
        fresh = threading.Thread(target=lambda: later.append(torch.get_num_threads()))
        fresh.start()
        fresh.join()
    finally:
        torch.set_num_threads(before)
    assert seen == [-1, 2, 2]
    assert later == [2]
