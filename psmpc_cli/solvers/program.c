/* A quadratic program of a window: its rows, its costs, and their derivatives by velocities and durations.
 *
 *     min  1/2 x'H x + g'x   over the steps x = (X, tau)
 *     s.t. low <= C x <= high,   the gaps of the dynamics closed.
 *
 * The rows C x are, in order: [Q; v] at nodes 1 .. K; the durations; their sums up to each; constraints at nodes;
 * accelerations from below, from above (as velocities: dv - h u_low >= 0, dv - h u_high <= 0).
 */

typedef struct {
    int64_t K, node_rows, inputs, max_iterations, soft; /* the last: the bounds of [Q; v] are */
    double tolerance, acceptable_tolerance, initial_barrier, bound_push;
    const double *positions, *gradient, *gradient_tau, *coupling, *arrow, *durations, *gap_velocity, *gap_tau, *gaps;
    const int64_t *row_node;
    const double *row_jacobian, *low, *high, *input_low, *input_high, *interval_by_duration;
    const double *penalty; /* of soft rows by node, (K,) */
    double *work;
    double *X, *tau, *gap_multipliers, *multipliers, *report;
} Program;

/* One-sided limits of rows, distance d = sign (row - bound) >= 0, one array for each number. Slack s and multiplier z:
 *
 *     d - s = 0,   s z = mu.
 *
 * A soft one may be violated by e, at a cost of its node's `penalty` times e, with the multiplier w of e >= 0:
 *
 *     d + e - s = 0,   s z = mu,   e w = mu,   z + w = penalty.
 *
 * Both e and w are eliminated: with e = mu / w and z + w constant, what is left of a soft limit is a hard one whose
 * slack is larger by `relaxation` z = (e / w) z and whose distance is larger by `relaxation_shift` = mu / w.
 * Wright: Primal-Dual Interior-Point Methods (1997), chapter 10; Frison, Diehl: HPIPM (2020), soft constraints.
 */
typedef struct {
    int64_t count, *row;
    double *sign, *distance, *slack, *z, *ds, *dz, *inverse_diagonal;
    double *e, *w, *de, *relaxation, *relaxation_shift; /* of soft ones */
} Limits;

/* Rows that are equations: their residuals C x - b, their multipliers y and the step dy of these. */
typedef struct {
    int64_t count, *row;
    double *residual, *y, *dy;
} Equations;

typedef struct {
    const Program *p;
    double max_weight;     /* greatest weight of a row in the Hessian: the inverse of the proximal parameter */
    double residual, gap; /* largest one of limits and equations; the sum of s z and e w */
    Limits hard, soft;
    Equations equations;
    RiccatiData riccati;
    IntervalFactors *intervals;
    double *weight, *q, *step; /* of the rows: weight, multiplier, step; the first steps are those of [Q; v] */
    double *y, *cost, *cost_tau, *gradient_X, *u, *dtau, *schur, *gradient_velocity, *arrow, *difference, *durations;
    vec *positions;
} Solver;

static int64_t row_count(const Program *p) {
    return p->K * M + 2 * S + p->node_rows + (p->inputs ? 2 * p->K * N : 0);
}

/* Apply C to (X, tau): set the rows behind the first, which are X. */
static void apply_rows(const Program *p, const double *tau, double *rows) {
    const double *X = rows;
    double sum = 0.0;
    double *out = rows + p->K * M;
    for (int c = 0; c < S; c++) out[c] = tau[c], out[S + c] = sum += tau[c];
    out += 2 * S;
    for (int64_t e = 0; e < p->node_rows; e++) {
        double value = 0.0;
        for (int i = 0; i < M; i++) value += p->row_jacobian[e * M + i] * X[p->row_node[e] * M + i];
        *out++ = value;
    }
    if (!p->inputs) return;
    for (int64_t k = 0; k < p->K; k++) {
        double h = 0.0;
        for (int c = 0; c < S; c++) h += p->interval_by_duration[k * S + c] * tau[c];
        for (int i = 0; i < N; i++) {
            double difference = X[k * M + N + i] - (k ? X[(k - 1) * M + N + i] : 0.0);
            out[k * N + i] = difference - p->input_low[k * N + i] * h;
            out[(p->K + k) * N + i] = difference - p->input_high[k * N + i] * h;
        }
    }
}

/* Add C'q to (X, tau). */
static void add_rows_transposed(const Program *p, const double *q, double *restrict X, double *restrict tau) {
    for (int64_t i = 0; i < p->K * M; i++) X[i] += q[i];
    q += p->K * M;
    double later = 0.0;
    for (int c = S - 1; c >= 0; c--) tau[c] += q[c] + (later += q[S + c]);
    q += 2 * S;
    for (int64_t e = 0; e < p->node_rows; e++, q++)
        for (int i = 0; i < M; i++) X[p->row_node[e] * M + i] += *q * p->row_jacobian[e * M + i];
    if (!p->inputs) return;
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) {
            double low = q[k * N + i];
            double high = q[(p->K + k) * N + i];
            double by_h = low * p->input_low[k * N + i] + high * p->input_high[k * N + i];
            X[k * M + N + i] += low + high;
            if (k) X[(k - 1) * M + N + i] -= low + high;
            for (int c = 0; c < S; c++) tau[c] -= by_h * p->interval_by_duration[k * S + c];
        }
}

/* Compute the gradient H x + g of the objective at (X, tau). */
static void cost_gradient(Solver *s, const double *X, const double *tau) {
    const Program *p = s->p;
    memcpy(s->cost, p->gradient, p->K * M * sizeof(double));
    for (int c = 0; c < S; c++) {
        s->cost_tau[c] = p->gradient_tau[c];
        for (int e = 0; e < S; e++) s->cost_tau[c] += p->durations[c * S + e] * tau[e];
    }
    for (int64_t k = 0; k < p->K; k++) {
        const double *x = X + k * M;
        double *g = s->cost + k * M;
        vec sum[NV];
        memset(sum, 0, sizeof sum);
        for (int j = 0; j < N; j++)
            for (int v = 0; v < NV; v++) sum[v] += x[j] * s->positions[(k * N + j) * NV + v];
        for (int i = 0; i < N; i++) g[i] += const_scalars(sum)[i];
        for (int i = 0; i < N; i++) {
            double force = -p->coupling[k * N + i] * (x[N + i] - (k ? x[N + i - M] : 0.0));
            g[N + i] += force;
            if (k) g[N + i - M] -= force;
        }
        for (int i = 0; i < M; i++)
            for (int c = 0; c < S; c++) {
                g[i] += p->arrow[(k * M + i) * S + c] * tau[c];
                s->cost_tau[c] += p->arrow[(k * M + i) * S + c] * x[i];
            }
    }
}

/* Reduce derivatives by (X, tau) to those by the velocities (K, N) and tau, in place of tau's: the positions follow
 * from both. The adjoint of the dynamics gives the multipliers `gaps` (K, N) with which the derivative by Q_k vanishes,
 *
 *     lambda_k = lambda_k+1 - dL/dQ_k,   dL/dv_k + b_k lambda_k + a_k+1 lambda_k+1. */
static void reduced_gradient(const Program *p, const double *by_X, double *by_tau, double *by_velocity, double *gaps) {
    double lambda[N] = {0};
    double after[N];
    for (int64_t k = p->K - 1; k >= 0; k--) {
        double b = p->gap_velocity[2 * k + 1];
        double a_next = k + 1 < p->K ? p->gap_velocity[2 * k + 2] : 0.0;
        for (int i = 0; i < N; i++) {
            after[i] = lambda[i];
            lambda[i] -= by_X[k * M + i];
            by_velocity[k * N + i] = by_X[k * M + N + i] + b * lambda[i] + a_next * after[i];
            gaps[k * N + i] = lambda[i];
            for (int c = 0; c < S; c++) by_tau[c] += lambda[i] * p->gap_tau[(k * N + i) * S + c];
        }
    }
}
