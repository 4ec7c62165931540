/* Nonlinear algebraic equations, block by block, by Newton's method with damping.
 *
 * J. E. Dennis, R. B. Schnabel, Numerical Methods for Unconstrained Optimization and Nonlinear
 * Equations (1983), chapter 6. Of several solutions the one next to the last is taken.
 */

enum { LOOP_ITERATIONS = 60, LOOP_HALVINGS = 12 };

typedef struct {
    double residual[ROOM(N_LOOPS)];
    double jacobian[ROOM(N_LOOPS * N_LOOPS)];
} Linearised;

static void linearise_loops(Instance *m, const Point *at, Linearised *result)
{
    const double *arguments[] = {AT(m, at)};
    double *results[] = {result->residual, result->jacobian};
    model_loops(arguments, results, NULL, NULL, 0);
}

/* Size of the Newton correction of a block in units of its unknowns; the correction itself. */
static double correction(const Point *at, const Linearised *now, int begin, int size, double *step)
{
    double matrix[ROOM(N_LOOPS * N_LOOPS)], largest = 0;
    for (int j = 0; j < size; j++)
        for (int i = 0; i < size; i++)
            matrix[i + j * size] = now->jacobian[begin + i + (begin + j) * N_LOOPS];
    for (int i = 0; i < size; i++)
        step[i] = -now->residual[begin + i];
    if (!solve_linear(size, matrix, step))
        return INFINITY;
    for (int i = 0; i < size; i++) {
        const double unit = model_loop_nominals[begin + i] + fabs(at->loops[begin + i]);
        const double relative = fabs(step[i]) / unit;
        if (!(relative <= largest)) /* also if it is not a number */
            largest = relative;
    }
    return largest;
}

static double block_norm(const Linearised *now, int begin, int size)
{
    double sum = 0;
    for (int i = begin; i < begin + size; i++)
        sum += now->residual[i] * now->residual[i];
    return sqrt(sum);
}

static bool solve_block(Instance *m, Point *at, int begin, int size)
{
    Linearised now;
    double step[ROOM(N_LOOPS)], from[ROOM(N_LOOPS)], last = INFINITY;
    linearise_loops(m, at, &now);
    for (int iteration = 0; iteration < LOOP_ITERATIONS; iteration++) {
        const double norm = block_norm(&now, begin, size);
        const double change = correction(at, &now, begin, size, step);
        if (norm == 0)
            return true;
        if (!isfinite(change))
            return false;
        memcpy(from, at->loops, sizeof from);
        double share = 1;
        for (int halving = 0;; halving++) {
            for (int i = 0; i < size; i++)
                at->loops[begin + i] = from[begin + i] + share * step[i];
            linearise_loops(m, at, &now);
            /* Small corrections are rounding errors, which need not fall. */
            if (change < 1e-9 || block_norm(&now, begin, size) < norm)
                break;
            if (halving == LOOP_HALVINGS)
                return false;
            share /= 2;
        }
        if (change < 1e-14 || (change < 1e-11 && change >= 0.5 * last))
            return true;
        last = change;
    }
    return last < 1e-9;
}

static void solve_from(Instance *m, Point *at, const double *guess)
{
    memcpy(at->loops, guess, sizeof at->loops);
    int begin = 0;
    for (int block = 0; block < N_LOOP_BLOCKS; block++) {
        const int size = model_loop_sizes[block];
        if (!solve_block(m, at, begin, size)) {
            for (int i = begin; i < N_LOOPS; i++)
                at->loops[i] = NAN;
            return;
        }
        begin += size;
    }
}

static bool is_solution(const Point *at)
{
    for (int i = 0; i < N_LOOPS; i++)
        if (!isfinite(at->loops[i]))
            return false;
    return true;
}

static void remember_loops(Instance *m, const Point *at)
{
    if (N_LOOPS == 0 || !is_solution(at))
        return;
    memcpy(m->now.loops, at->loops, sizeof at->loops);
    m->now.loops_time = at->time;
}

/* Solve the nonlinear blocks of a situation. Trials start from the solution at the present. */
static void solve_loops(Instance *m, Point *at)
{
    if (N_LOOPS == 0)
        return;
    if (m->now.loops_time != m->now.values[TIME]) {
        Point present = *at;
        present.time = m->now.values[TIME];
        present.states = m->now.values + STATES;
        memcpy(present.inputs, m->now.values + INPUTS, N_INPUTS * sizeof(double));
        memcpy(present.relations, m->now.relations, sizeof present.relations);
        solve_from(m, &present, m->now.loops);
        remember_loops(m, &present);
    }
    solve_from(m, at, m->now.loops);
}

static bool loops_are_solved(Instance *m, const Point *at)
{
    for (int i = 0; i < N_LOOPS; i++)
        if (!isfinite(at->loops[i]))
            return fail(m, "the nonlinear equations for '%s' have no solution near the last one, "
                           "at time %.9g; give a start value", model_loop_names[i], at->time);
    return true;
}
