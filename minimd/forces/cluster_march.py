"""Many steps with all list builds between them as one kernel, which returns to Python when they are made,
or when it is needed there."""

from minimd.compiled.call_by_address import call_at, run_at
from minimd.compiled.fixed_point import is_fixed
from minimd.compiled.kernels import by_type, shared_kernel
from minimd.forces.cluster_kernel import MADE, TO_MAKE
from minimd.neighbors.cluster_search import LAYERS
from minimd.neighbors.clusters import any_moved_from_clusters, columns_fit
from minimd.neighbors.verlet_list import count_not_finite

TASKS_PER_MOVE = 2  # at most: an evaluation with its kick and drift, and a list build


@shared_kernel
def march_clusters(worker, task, evaluate, evaluation, build, building):
    """Kicks and drifts, all that motion.course asks for, with list builds where they are due; on one thread.

    Returns the number of list builds.

    It makes fewer if positions are not finite, if something has left the range of fixed-point arithmetic, or if a list
    needs other columns or more memory; then there is no list, and rows.layers is zero.

    evaluate, build : addresses of evaluate_clusters and build_clusters.  evaluation, building : their arguments,
        but for worker and task.
    """
    positions, arrays, loop, _, motion = evaluation
    course, rows, n_builds = motion.course, arrays.rows, 0
    while True:
        course[MADE] += call_at(evaluate, (worker, task) + evaluation)
        task += 1
        if course[MADE] >= course[TO_MAKE] or is_out_of_range(arrays, motion.steps):
            return n_builds
        while any_moved_from_clusters(positions, arrays.clusters, rows.limits2[rows.layers[0] - 1]):
            rows.layers[0] += 1
            if rows.layers[0] > LAYERS:
                rows.layers[0] = 0
                if count_not_finite(positions)[0] > 0 or not columns_fit(positions, building[1].layout.columns):
                    return n_builds
                if call_at(build, (worker, task) + building) == 0:
                    return n_builds
                rows.layers[0], task, n_builds = 1, task + 1, n_builds + 1
        if loop.prepare != 0:
            run_at(loop.prepare, (arrays, loop.work))


@by_type
def is_out_of_range(arrays, steps):
    """Whether a force or a momentum has left its range, in fixed-point arithmetic."""
    if not is_fixed(steps):
        return lambda arrays, steps: False
    return lambda arrays, steps: arrays.memory.net.any()
