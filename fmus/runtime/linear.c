/* Dense linear equations of the few unknowns that a model has; matrices are stored by columns. */

/* Factorise A = P L U in place by elimination with row exchange; false if A is singular. */
static bool factorise(int n, double *A, int *pivots)
{
    for (int k = 0; k < n; k++) {
        int pivot = k;
        for (int i = k + 1; i < n; i++)
            if (fabs(A[i + k * n]) > fabs(A[pivot + k * n]))
                pivot = i;
        if (!(fabs(A[pivot + k * n]) > DBL_MIN))
            return false;
        pivots[k] = pivot;
        for (int j = 0; j < n; j++) {
            const double swap = A[k + j * n];
            A[k + j * n] = A[pivot + j * n];
            A[pivot + j * n] = swap;
        }
        for (int i = k + 1; i < n; i++)
            A[i + k * n] /= A[k + k * n];
        for (int j = k + 1; j < n; j++)
            for (int i = k + 1; i < n; i++)
                A[i + j * n] -= A[i + k * n] * A[k + j * n];
    }
    return true;
}

/* Solve A y = b in place, with the factors of A. */
static void substitute(int n, const double *factors, const int *pivots, double *b)
{
    for (int k = 0; k < n; k++) {
        const double swap = b[k];
        b[k] = b[pivots[k]];
        b[pivots[k]] = swap;
    }
    for (int j = 0; j < n; j++)
        for (int i = j + 1; i < n; i++)
            b[i] -= factors[i + j * n] * b[j];
    for (int j = n - 1; j >= 0; j--) {
        b[j] /= factors[j + j * n];
        for (int i = 0; i < j; i++)
            b[i] -= factors[i + j * n] * b[j];
    }
}

/* Solve A y = b in place; A is destroyed. */
static bool solve_linear(int n, double *A, double *b)
{
    int pivots[ROOM(N_STATES + N_INITIAL + N_RELATIONS + N_LOOPS)];
    if (!factorise(n, A, pivots))
        return false;
    substitute(n, A, pivots, b);
    return true;
}
