/* A step of RODAS4P, a Rosenbrock method of order 4(3) for stiff models: L-stable, and it solves
 * linear equations only.
 *
 * G. Steinebach, Order-reduction of ROW-methods for DAEs and method of lines applications,
 * Technische Hochschule Darmstadt, preprint 1741 (1995); in the form of E. Hairer, G. Wanner,
 * Solving Ordinary Differential Equations II, IV.7, which needs no product with the Jacobian.
 */

enum { ROW_STAGES = 6 };

#define ROW_GAMMA 0.25

static const double ROW_NODES[ROW_STAGES] = {0, 0.75, 0.21, 0.63, 1, 1};
static const double ROW_TREND[ROW_STAGES] = {0.25, -0.5, -0.023504, -0.0362, 0, 0};
static const double ROW_WEIGHTS[ROW_STAGES][ROW_STAGES - 1] = {
    {0},
    {3},
    {1.831036793486759, 0.4955183967433795},
    {2.304376582692669, -0.05249275245743001, -1.176798761832782},
    {-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401},
    {-7.170454962423024, -4.741636671481785, -16.31002631330971, -1.062004044111401, 1},
};
static const double ROW_COUPLING[ROW_STAGES][ROW_STAGES - 1] = {
    {0},
    {-12},
    {-8.791795173947035, -2.207865586973518},
    {10.81793056857153, 6.780270611428266, 19.53485944642410},
    {34.19095006749676, 15.49671153725963, 54.74760875964130, 14.16005392148534},
    {34.62605830930532, 15.30084976114473, 56.99955578662667, 18.40807009793095,
     -5.714285714285717},
};
static const double ROW_DENSE[2][ROW_STAGES - 1] = {
    {25.09876703708589, 11.62013104361867, 28.49148307714626, -5.664021568594133, 0},
    {1.638054557396973, -0.7373619806678748, 8.477918219238990, 15.99253148779520,
     -1.882352941176471},
};

/* Below this product of step and fastest rate, the explicit method is the cheaper one. */
#define STIFFNESS_LIMIT 1.0

/* Jacobian of the derivatives by the states, by columns. */
static void state_jacobian(Instance *m, double *jacobian)
{
    const Point at = point_now(m);
    const double none[ROOM(N_PARAMETERS + N_INPUTS)] = {0};
    double seed[ROOM(N_STATES)] = {0}, change[ROOM(N_STATES + N_OTHERS)];
    for (int j = 0; j < N_STATES; j++) {
        if (m->now.sliding == 0) {
            seed[j] = 1;
            CALL(model_directional, change, AT(m, &at), seed, none, none);
            seed[j] = 0;
        } else {
            /* A mean of both sides of a surface, whose shares change as well. */
            double x[ROOM(N_STATES)], above[ROOM(N_STATES)];
            const double shift = 1e-5 * (model_nominals[j] + fabs(at.states[j]));
            memcpy(x, at.states, sizeof x);
            x[j] = at.states[j] + shift;
            evaluate_derivatives(m, at.time, x, above);
            x[j] = at.states[j] - shift;
            evaluate_derivatives(m, at.time, x, change);
            for (int i = 0; i < N_STATES; i++)
                change[i] = (above[i] - change[i]) / (2 * shift);
        }
        memcpy(jacobian + j * N_STATES, change, N_STATES * sizeof(double));
    }
}

/* Linearise about the present: Jacobian and partial derivative by time. */
static void linearise(Instance *m, Step *step)
{
    const double time = m->now.values[TIME], *x = m->now.values + STATES;
    const double shift = fmax(1e-2 * step->size, 1e-7 * fabs(time));
    double after[ROOM(N_STATES)], before[ROOM(N_STATES)];
    state_jacobian(m, step->jacobian);
    evaluate_derivatives(m, time + shift, x, after);
    evaluate_derivatives(m, time - shift, x, before);
    for (int i = 0; i < N_STATES; i++)
        step->trend[i] = (after[i] - before[i]) / (2 * shift);
    step->fastest = 0;
    for (int i = 0; i < N_STATES; i++) {
        double sum = 0;
        for (int j = 0; j < N_STATES; j++)
            sum += fabs(step->jacobian[i + j * N_STATES]);
        step->fastest = fmax(step->fastest, sum);
    }
    step->is_linearised = true;
}

static double rosenbrock(Instance *m, Step *step)
{
    const int n = N_STATES;
    const double time = m->now.values[TIME], *x = m->now.values + STATES, size = step->size;
    double stages[ROW_STAGES][ROOM(N_STATES)], y[ROOM(N_STATES)], W[ROOM(N_STATES * N_STATES)];
    int pivots[ROOM(N_STATES)];
    if (!step->is_linearised)
        linearise(m, step);
    for (int i = 0; i < n * n; i++)
        W[i] = (i % (n + 1) == 0 ? 1 / (ROW_GAMMA * size) : 0) - step->jacobian[i];
    if (!factorise(n, W, pivots))
        return INFINITY; /* a shorter step makes the diagonal larger */
    for (int s = 0; s < ROW_STAGES; s++) {
        double *stage = stages[s];
        for (int i = 0; i < n; i++) {
            y[i] = x[i];
            for (int j = 0; j < s; j++)
                y[i] += ROW_WEIGHTS[s][j] * stages[j][i];
        }
        if (s == 0)
            memcpy(stage, step->slope, sizeof stages[0]);
        else
            evaluate_derivatives(m, time + ROW_NODES[s] * size, y, stage);
        for (int i = 0; i < n; i++) {
            double sum = 0;
            for (int j = 0; j < s; j++)
                sum += ROW_COUPLING[s][j] * stages[j][i];
            stage[i] += sum / size + size * ROW_TREND[s] * step->trend[i];
        }
        substitute(n, W, pivots, stage);
    }
    double error = 0;
    for (int i = 0; i < n; i++) {
        const double last = stages[ROW_STAGES - 1][i];
        step->end[i] = y[i] + last;
        const double part = last / scale(m, i, x[i], step->end[i]);
        error += part * part;
        for (int k = 0; k < 2; k++) {
            step->dense[k][i] = 0;
            for (int j = 0; j < ROW_STAGES - 1; j++)
                step->dense[k][i] += ROW_DENSE[k][j] * stages[j][i];
        }
        step->dense[2][i] = 0;
    }
    evaluate_derivatives(m, time + size, step->end, step->end_slope);
    step->is_limited = size * step->fastest > STIFFNESS_LIMIT;
    return sqrt(error / ROOM(N_STATES));
}
