import threading

import torch

from mixer_torch.solvers.one_thread import one_thread


def test_the_limit_is_that_of_the_calling_thread_and_ends():
    before, elsewhere = torch.get_num_threads(), []

    def look():
        elsewhere.append(torch.get_num_threads())

    with one_thread():
        assert torch.get_num_threads() == 1
        other = threading.Thread(target=look)
        other.start()
        other.join()
    assert torch.get_num_threads() == before
    assert elsewhere == [before]
