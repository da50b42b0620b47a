"""Greedy contraction and Kernighan-Lin with joins: an independent peer of the solvers.

GAEC and KLj as Keuper, Levinkov, Bonneel, Lavoue, Brox and Andres published them (Efficient
decomposition of image and mesh graphs by lifted multicuts, ICCV 2015, algorithms 1 to 3), with one
constraint more: no two nodes of a cluster are of one view. Nothing here is shared with the moves of
mixer_torch but how they are compiled. Costs are to be minimised: negative attracts.

Along a chain of Kernighan-Lin moves two nodes of one view may be on one side for a while; only
where the constraint holds may a chain end.
"""

import heapq

import numpy as np

from mixer_torch.solvers.compiled import compiled

TINY = -1e-9  # a change of the cost that counts is below


def graph_of(pairs, cost, view):
    """What :func:`gaec` and :func:`klj` take: start, neighbour and cost of the edges, and view.

    Args:
        pairs: (2, P) nodes, each pair once.
        cost: (P,) float64.
        view: (m,) ints; a negative one is distinct from nothing.
    """
    near, far = np.r_[pairs[0], pairs[1]], np.r_[pairs[1], pairs[0]]
    order = np.lexsort((far, near))
    start = np.searchsorted(near[order], np.arange(len(view) + 1))
    return start, far[order], np.r_[cost, cost][order], view


@compiled
def gaec(start, neighbour, cost, view):
    """Join the two clusters of the most negative total cost, until there are none."""
    n = len(view)
    between = {np.int64(-1): 0.0}  # cost between clusters u < v under u n + v
    heap = [(0.0, 0, 0) for _ in range(0)]
    for u in range(n):
        for e in range(start[u], start[u + 1]):
            if u < neighbour[e] and not _same_view(view, u, neighbour[e]):
                between[u * n + neighbour[e]] = cost[e]
                heap.append((cost[e], u, neighbour[e]))
    heapq.heapify(heap)
    root, after, last = np.arange(n), np.full(n, -1), np.arange(n)  # members as linked lists
    degree = np.diff(start)
    while heap and heap[0][0] < 0:
        value, u, v = heapq.heappop(heap)
        if between.get(u * n + v, 0.0) != value or _share_view(u, v, after, view):
            continue
        if degree[u] < degree[v]:
            u, v = v, u
        _hand_over(start, neighbour, root, after, u, v, between, heap)
        i = v
        while i >= 0:
            root[i] = u
            i = after[i]
        after[last[u]], last[u] = v, last[v]
        degree[u] += degree[v]
    return root


@compiled
def _hand_over(start, neighbour, root, after, u, v, between, heap):
    """The costs between v and others are added to those of u."""
    n, i = len(root), v
    while i >= 0:
        for e in range(start[i], start[i + 1]):
            w = root[neighbour[e]]
            old = min(v, w) * n + max(v, w)
            if old in between:
                moved = between.pop(old)
                if w != u:
                    key = min(u, w) * n + max(u, w)
                    between[key] = between.get(key, 0.0) + moved
                    heapq.heappush(heap, (between[key], min(u, w), max(u, w)))
        i = after[i]


@compiled
def _same_view(view, i, j):
    return view[i] >= 0 and view[i] == view[j]


@compiled
def _share_view(u, v, after, view):
    i = u
    while i >= 0:
        j = v
        while j >= 0:
            if _same_view(view, i, j):
                return True
            j = after[j]
        i = after[i]
    return False


@compiled
def klj(start, neighbour, cost, view, label):
    """Improve every pair of neighbouring clusters, and split clusters, until nothing changes."""
    n = len(view)
    graph, label = (start, neighbour, cost, view), label.copy()
    members = [[np.int64(0) for _ in range(0)] for _ in range(n + 1)]
    for i in range(n):
        members[label[i]].append(i)
    empty = [c for c in range(n, -1, -1) if len(members[c]) == 0]
    changed = np.ones(n + 1, np.bool_)
    seen, place = np.full(n + 1, -1), np.full(n, -1)
    while changed.any():
        todo, changed = changed, np.zeros(n + 1, np.bool_)
        for a in range(n + 1):
            for b in _near(graph, label, members, a, seen):
                if (todo[a] or todo[b]) and _improve(graph, label, members, a, b, place):
                    changed[a] = changed[b] = True
                    if len(members[b]) == 0:
                        empty.append(b)
                    if len(members[a]) == 0:
                        empty.append(a)
                        break
            while (todo[a] or changed[a]) and len(members[a]) > 1:
                if not _improve(graph, label, members, a, empty[-1], place):
                    break
                changed[a] = changed[empty.pop()] = True
    return label


@compiled
def _near(graph, label, members, a, seen):
    """Clusters after a that an edge connects with it; seen is left as it was found."""
    start, neighbour, _, _ = graph
    near = [a for _ in range(0)]
    for i in members[a]:
        for e in range(start[i], start[i + 1]):
            b = label[neighbour[e]]
            if b > a and seen[b] < 0:
                seen[b] = a
                near.append(b)
    for b in near:
        seen[b] = -1
    return near


@compiled
def _improve(graph, label, members, a, b, place):
    """The best end of a chain of moves between two clusters, or their join, if either gains."""
    nodes, first = np.array(members[a] + members[b]), len(members[a])
    weight, clash = _between(graph, nodes, place)
    side = np.arange(len(nodes)) >= first
    chain, length, best = _chain(weight, clash, side)
    join = weight[:first, first:].sum()
    if clash.any() or join >= best:
        for step in range(length):
            side[chain[step]] = not side[chain[step]]
    else:
        side[:] = False
        best = join
    if best >= TINY:
        return False
    members[a].clear()
    members[b].clear()
    for p in range(len(nodes)):
        label[nodes[p]] = b if side[p] else a
        members[label[nodes[p]]].append(nodes[p])
    return True


@compiled
def _between(graph, nodes, place):
    """(k, k) costs between some nodes, and which two of them are of one view."""
    start, neighbour, cost, view = graph
    weight, clash = np.zeros((len(nodes), len(nodes))), np.zeros((len(nodes), len(nodes)), np.bool_)
    for p in range(len(nodes)):
        place[nodes[p]] = p
    for p in range(len(nodes)):
        for e in range(start[nodes[p]], start[nodes[p] + 1]):
            if place[neighbour[e]] >= 0:
                weight[p, place[neighbour[e]]] = cost[e]
        for q in range(len(nodes)):
            clash[p, q] = p != q and _same_view(view, nodes[p], nodes[q])
    for p in range(len(nodes)):
        place[nodes[p]] = -1
    return weight, clash


@compiled
def _chain(weight, clash, side):
    """Every node changes sides once, the best one first.

    Returns:
        The nodes in that order, after how many of them the cost is least, and its change.
    """
    count, side = len(side), side.copy()
    gain = np.zeros(count)  # change of the cost by the move of each node
    for p in range(count):
        for q in range(count):
            gain[p] += weight[p, q] if side[p] != side[q] else -weight[p, q]
    chain, total, best, length, conflicts = np.empty(count, np.int64), 0.0, 0.0, 0, 0
    for step in range(count):
        p = gain.argmin()
        total += gain[p]
        for q in range(count):
            apart = side[p] != side[q]
            gain[q] += -2 * weight[p, q] if apart else 2 * weight[p, q]
            if clash[p, q]:
                conflicts += 1 if apart else -1
        chain[step], gain[p], side[p] = p, np.inf, not side[p]
        if conflicts == 0 and total < best + TINY:
            best, length = total, step + 1
    return chain, length, best
