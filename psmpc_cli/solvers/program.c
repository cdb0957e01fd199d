/* A quadratic program of a window: its rows, its costs, and their derivatives by velocities and durations.
 *
 * Rows stand between low and high: bounds of [Q; v] at nodes 1 .. K; of the durations; of their sums up to each; end
 * rows; accelerations from below, from above.
 */

typedef struct {
    int64_t K, ends, inputs, limit, soft; /* the last: the bounds of [Q; v] are */
    double tolerance, nearly, barrier, push;
    const double *positions, *gradient, *gradient_tau, *coupling, *arrow, *durations, *gap_velocity, *gap_tau, *gaps;
    const int64_t *end_node;
    const double *end_rows, *low, *high, *input_low, *input_high, *share;
    const double *penalty; /* of soft rows by node, (K,) */
    double *work;
    double *X, *tau, *gap_multipliers, *multipliers, *report;
} Program;

/* One-sided limits of rows, room = sign (row - bound) >= 0, one array for each number.
 *
 *     room - slack = 0,   slack z = mu
 *
 * A soft one may be violated, at a cost of its node's `penalty` times the violation e:
 *
 *     room + e - slack = 0,   slack z = mu,   e w = mu,   z + w = penalty
 *
 * Both e and its multiplier w are eliminated: what is left of a soft limit is a hard one with a larger slack,
 * slack + give z with give = e / w, whose room is larger by way = mu / w.
 */
typedef struct {
    int64_t count, *row;
    double *sign, *room, *slack, *z, *ds, *dz, *inverse;
    double *e, *w, *de, *give, *way; /* of soft ones */
} Limits;

/* Rows that are equations: how far they are off, their multipliers and the step of these. */
typedef struct {
    int64_t count, *row;
    double *off, *y, *dy;
} Equations;

typedef struct {
    const Program *p;
    double stiffness;     /* greatest weight a row gets */
    double residual, gap; /* largest one of limits and equations; sum of the complementarities */
    Limits hard, soft;
    Equations equations;
    Stages stages;
    Interval *intervals;
    double *weight, *q, *step; /* of the rows: weight, multiplier, step; the first steps are those of [Q; v] */
    double *y, *cost, *cost_tau, *lin, *u, *dtau, *U, *adjoint, *arrow, *difference, *durations;
    vec *positions;
} Solver;

static int64_t row_count(const Program *p) {
    return p->K * M + 2 * S + p->ends + (p->inputs ? 2 * p->K * N : 0);
}

/* Set the rows behind their first, which are X. */
static void rows_of(const Program *p, const double *tau, double *rows) {
    const double *X = rows;
    double sum = 0.0, *out = rows + p->K * M;
    for (int c = 0; c < S; c++) out[c] = tau[c], out[S + c] = sum += tau[c];
    out += 2 * S;
    for (int64_t e = 0; e < p->ends; e++) {
        double value = 0.0;
        for (int i = 0; i < M; i++) value += p->end_rows[e * M + i] * X[p->end_node[e] * M + i];
        *out++ = value;
    }
    if (!p->inputs) return;
    for (int64_t k = 0; k < p->K; k++) {
        double h = 0.0;
        for (int c = 0; c < S; c++) h += p->share[k * S + c] * tau[c];
        for (int i = 0; i < N; i++) {
            double difference = X[k * M + N + i] - (k ? X[(k - 1) * M + N + i] : 0.0);
            out[k * N + i] = difference - p->input_low[k * N + i] * h;
            out[(p->K + k) * N + i] = difference - p->input_high[k * N + i] * h;
        }
    }
}

/* Add the rows' transpose times q to (X, tau). */
static void add_rows(const Program *p, const double *q, double *restrict X, double *restrict tau) {
    for (int64_t i = 0; i < p->K * M; i++) X[i] += q[i];
    q += p->K * M;
    double later = 0.0;
    for (int c = S - 1; c >= 0; c--) tau[c] += q[c] + (later += q[S + c]);
    q += 2 * S;
    for (int64_t e = 0; e < p->ends; e++, q++)
        for (int i = 0; i < M; i++) X[p->end_node[e] * M + i] += *q * p->end_rows[e * M + i];
    if (!p->inputs) return;
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) {
            double low = q[k * N + i], high = q[(p->K + k) * N + i];
            double by_h = low * p->input_low[k * N + i] + high * p->input_high[k * N + i];
            X[k * M + N + i] += low + high;
            if (k) X[(k - 1) * M + N + i] -= low + high;
            for (int c = 0; c < S; c++) tau[c] -= by_h * p->share[k * S + c];
        }
}

/* Gradient of the objective at (X, tau). */
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
        for (int i = 0; i < N; i++) g[i] += values(sum)[i];
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

/* Reduce derivatives by (X, tau) to those by the velocities (K, N) and tau, in place of tau's.
 * `gaps` (K, N): the multipliers of the gaps that make the derivative by the positions vanish. */
static void reduce(const Program *p, const double *by_X, double *by_tau, double *by_velocity, double *gaps) {
    double lambda[N] = {0}, after[N];
    for (int64_t k = p->K - 1; k >= 0; k--) {
        double b = p->gap_velocity[2 * k + 1], a_next = k + 1 < p->K ? p->gap_velocity[2 * k + 2] : 0.0;
        for (int i = 0; i < N; i++) {
            after[i] = lambda[i];
            lambda[i] -= by_X[k * M + i];
            by_velocity[k * N + i] = by_X[k * M + N + i] + b * lambda[i] + a_next * after[i];
            gaps[k * N + i] = lambda[i];
            for (int c = 0; c < S; c++) by_tau[c] += lambda[i] * p->gap_tau[(k * N + i) * S + c];
        }
    }
}
