"""Work in threads: results keep their order, and few wait at a time."""

import threading
import time

from ovibjax.runtime.threads import in_order


def test_in_order_keeps_order_and_bounds_what_waits():
    started, most, lock = [], 0, threading.Lock()

    def work(item):
        with lock:
            started.append(item)
        time.sleep(0.001 * (item % 3))
        return item * item

    taken = []
    for result in in_order(work, range(50), ahead=5):
        with lock:
            most = max(most, len(started) - len(taken))
        taken.append(result)
    assert taken == [item * item for item in range(50)] and most <= 6
    results = in_order(work, range(1000), ahead=4)
    next(results)
    results.close()
    assert len(started) < 70
