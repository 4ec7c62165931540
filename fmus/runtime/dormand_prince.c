/* A step of Dormand-Prince 5(4), the method for models that are not stiff.
 *
 * J. R. Dormand, P. J. Prince, A family of embedded Runge-Kutta formulae, J. Comp. Appl. Math. 6
 * (1980) 19-26; dense output and test of stiffness as in E. Hairer, S. P. Norsett, G. Wanner,
 * Solving Ordinary Differential Equations I, II.4-II.6, and II (with G. Wanner), IV.2.
 */

enum { STAGES = 7 };

static const double NODES[STAGES] = {0, 1. / 5, 3. / 10, 4. / 5, 8. / 9, 1, 1};
static const double WEIGHTS[STAGES][STAGES - 1] = {
    {0},
    {1. / 5},
    {3. / 40, 9. / 40},
    {44. / 45, -56. / 15, 32. / 9},
    {19372. / 6561, -25360. / 2187, 64448. / 6561, -212. / 729},
    {9017. / 3168, -355. / 33, 46732. / 5247, 49. / 176, -5103. / 18656},
    {35. / 384, 0, 500. / 1113, 125. / 192, -2187. / 6784, 11. / 84},
};
static const double ERROR[STAGES] = {71. / 57600,      0,          -71. / 16695, 71. / 1920,
                                     -17253. / 339200, 22. / 525,  -1. / 40};
static const double DENSE[STAGES] = {-12715105075. / 11282082432,  0,
                                     87487479700. / 32700410799,   -10690763975. / 1880347072,
                                     701980252875. / 199316789632, -1453857185. / 822651844,
                                     69997945. / 29380423};

/* The product of step and fastest rate from which on stability limits this method's steps. */
#define STABILITY_LIMIT 3.25

static double dormand_prince(Instance *m, Step *step)
{
    const double time = m->now.values[TIME], *x = m->now.values + STATES, size = step->size;
    double stages[STAGES][ROOM(N_STATES)], y[ROOM(N_STATES)] = {0}, before[ROOM(N_STATES)];
    memcpy(stages[0], step->slope, sizeof stages[0]);
    for (int s = 1; s < STAGES; s++) {
        memcpy(before, y, sizeof before);
        for (int i = 0; i < N_STATES; i++) {
            double sum = 0;
            for (int j = 0; j < s; j++)
                sum += WEIGHTS[s][j] * stages[j][i];
            y[i] = x[i] + size * sum;
        }
        evaluate_derivatives(m, time + NODES[s] * size, y, stages[s]);
    }
    memcpy(step->end, y, sizeof y);
    memcpy(step->end_slope, stages[STAGES - 1], sizeof step->end_slope);
    double error = 0, bend = 0, shift = 0;
    for (int i = 0; i < N_STATES; i++) {
        double sum = 0, dense = 0;
        for (int s = 0; s < STAGES; s++) {
            sum += ERROR[s] * stages[s][i];
            dense += DENSE[s] * stages[s][i];
        }
        const double unit = scale(m, i, x[i], y[i]);
        error += (size * sum / unit) * (size * sum / unit);
        /* The last two stages are at the same time: their slopes differ by what y does. */
        const double a = size * (stages[STAGES - 1][i] - stages[STAGES - 2][i]) / unit;
        const double b = (y[i] - before[i]) / unit;
        bend += a * a;
        shift += b * b;
        const double rise = y[i] - x[i];
        step->dense[0][i] = size * step->slope[i] - rise;
        step->dense[1][i] = rise - size * step->end_slope[i] - step->dense[0][i];
        step->dense[2][i] = size * dense;
    }
    step->is_limited = shift > 0 && bend > STABILITY_LIMIT * STABILITY_LIMIT * shift;
    return sqrt(error / ROOM(N_STATES));
}
