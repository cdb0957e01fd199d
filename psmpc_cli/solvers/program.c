/* A quadratic program of a window: its rows, its costs, and their derivatives by velocities and durations.
 *
 * Rows stand between low and high: bounds of [Q; v] at nodes 1 .. K; of the durations; of their sum; end rows;
 * accelerations from below, from above.
 */

typedef struct {
    int64_t K, ends, given, inputs, limit, soft; /* the last: the bounds of [Q; v] are */
    double tolerance, nearly, barrier, push;
    const double *positions, *gradient, *gradient_tau, *coupling, *arrow, *durations, *gap_velocity, *gap_tau, *gaps;
    const int64_t *end_node;
    const double *end_rows, *given_rows, *given_change, *low, *high, *input_low, *input_high, *share;
    const double *penalty; /* of soft rows by node, (K,) */
    double *work;
    double *X, *tau, *gap_multipliers, *multipliers, *given_multipliers, *report;
} Program;

/* One array for each row's number. */
typedef struct {
    int64_t count, soft; /* the first of them are soft */
    double *low, *high, *below, *above, *equal; /* the last three: 1 where there is such a limit, else 0 */
    double *v, *dv, *weight, *q;
    double *sl, *su, *zl, *zu, *dsl, *dsu, *dzl, *dzu, *il, *iu, *y, *dy, *from, *to;
    double *el, *eu, *wl, *wu, *del, *deu, *gl, *gu; /* of the soft rows, see below */
} Rows;

typedef struct {
    const Program *p;
    double stiffness; /* greatest weight a row gets */
    Rows rows;
    Stages stages;
    Interval *intervals;
    double *y, *cost, *cost_tau, *lin, *u, *dX, *dtau, *nu, *dnu, *U, *adjoint, *arrow;
    double *diagonal, *difference, *durations;
    vec *positions;
} Solver;

static int64_t row_count(const Program *p) {
    return p->K * M + S + 1 + p->ends + (p->inputs ? 2 * p->K * N : 0);
}

static void rows_of(const Program *p, const double *X, const double *tau, double *out) {
    double sum = 0.0;
    memcpy(out, X, p->K * M * sizeof(double));
    out += p->K * M;
    for (int c = 0; c < S; c++) sum += *out++ = tau[c];
    *out++ = sum;
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
    for (int c = 0; c < S; c++) tau[c] += q[c] + q[S];
    q += S + 1;
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

/* Add the transpose of the given sums of durations times nu. */
static void add_given(const Program *p, const double *nu, double *tau) {
    for (int e = 0; e < (int)p->given; e++)
        for (int c = 0; c < S; c++) tau[c] += p->given_rows[e * S + c] * nu[e];
}

/* How much a given sum of durations still has to change. */
static double given_left(const Program *p, const double *tau, int e) {
    double left = p->given_change[e];
    for (int c = 0; c < S; c++) left -= p->given_rows[e * S + c] * tau[c];
    return left;
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
/* Soft rows: the first `soft` of them may be violated, at a cost of its node's `penalty` times the violation.
 *
 *     v + el - sl = low,   sl zl = mu,   el wl = mu,   zl + wl = penalty
 *
 * for the limit below, with slack sl, violation el and its multiplier wl; likewise above. Violations and their
 * multipliers are eliminated: what is left of a soft row is a hard one with a larger slack, sl + zl el / wl, and a
 * limit that gives way by mu / wl.
 */

/* A row without such a limit has the numbers 1 and no share in anything. */
static void begin_soft(Rows *r, const double *penalties, double push, double barrier) {
    for (int64_t i = 0; i < r->soft; i++) {
        double penalty = penalties[i / M];
        double below = r->v[i] - r->low[i], above = r->high[i] - r->v[i];
        r->el[i] = r->eu[i] = r->wl[i] = r->wu[i] = 1.0;
        if (r->below[i] != 0.0) {
            r->el[i] = fmax(push - below, barrier / penalty);
            r->sl[i] = below + r->el[i];
            r->zl[i] = fmin(barrier / r->sl[i], penalty / 2);
            r->wl[i] = penalty - r->zl[i];
        }
        if (r->above[i] != 0.0) {
            r->eu[i] = fmax(push - above, barrier / penalty);
            r->su[i] = above + r->eu[i];
            r->zu[i] = fmin(barrier / r->su[i], penalty / 2);
            r->wu[i] = penalty - r->zu[i];
        }
        r->del[i] = r->deu[i] = 0.0;
    }
}

static double soft_residual(const Rows *r) {
    double worst = 0.0;
#pragma omp simd reduction(max : worst)
    for (int64_t i = 0; i < r->soft; i++) {
        double l = r->below[i] * fabs(r->v[i] - r->low[i] + r->el[i] - r->sl[i]);
        double u = r->above[i] * fabs(r->high[i] - r->v[i] + r->eu[i] - r->su[i]);
        l = l > u ? l : u;
        worst = worst > l ? worst : l;
    }
    return worst;
}

static void weigh_soft(Rows *r, double stiffness) {
    double least = 1.0 / stiffness;
#pragma omp simd
    for (int64_t i = 0; i < r->soft; i++) {
        r->gl[i] = r->el[i] / r->wl[i];
        r->gu[i] = r->eu[i] / r->wu[i];
        r->il[i] = 1.0 / (r->sl[i] + r->zl[i] * (least + r->gl[i]));
        r->iu[i] = 1.0 / (r->su[i] + r->zu[i] * (least + r->gu[i]));
        r->weight[i] = r->zl[i] * r->il[i] + r->zu[i] * r->iu[i];
    }
}

/* Where the limits give way to, before a direction. */
static void give_way(Rows *r, double target, double corrected) {
#pragma omp simd
    for (int64_t i = 0; i < r->soft; i++) {
        r->from[i] = r->low[i] - r->below[i] * (target + corrected * r->del[i] * r->dzl[i]) / r->wl[i];
        r->to[i] = r->high[i] + r->above[i] * (target + corrected * r->deu[i] * r->dzu[i]) / r->wu[i];
    }
}

/* The steps of the violations, and what they add to those of the slacks. */
static void direct_soft(Rows *r) {
#pragma omp simd
    for (int64_t i = 0; i < r->soft; i++) {
        double l = r->gl[i] * r->dzl[i], u = r->gu[i] * r->dzu[i];
        r->dsl[i] += l;
        r->dsu[i] += u;
        r->del[i] = r->below[i] * (r->low[i] - r->from[i] + l - r->el[i]);
        r->deu[i] = r->above[i] * (r->to[i] - r->high[i] + u - r->eu[i]);
    }
}

/* The largest relative decrease of a violation, and of a multiplier of one. */
static void shrink_soft(const Rows *r, double *primal, double *dual) {
    double e = *primal, w = *dual;
#pragma omp simd reduction(max : e, w)
    for (int64_t i = 0; i < r->soft; i++) {
        double a = -r->del[i] / r->el[i], b = -r->deu[i] / r->eu[i];
        double c = r->dzl[i] / r->wl[i], d = r->dzu[i] / r->wu[i];
        a = a > b ? a : b;
        c = c > d ? c : d;
        e = e > a ? e : a;
        w = w > c ? w : c;
    }
    *primal = e;
    *dual = w;
}

static double soft_complementarity(const Rows *r, double primal, double dual) {
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (int64_t i = 0; i < r->soft; i++)
        sum += r->below[i] * (r->el[i] + primal * r->del[i]) * (r->wl[i] - dual * r->dzl[i]) +
               r->above[i] * (r->eu[i] + primal * r->deu[i]) * (r->wu[i] - dual * r->dzu[i]);
    return sum;
}

static void move_soft(Rows *r, double primal, double dual) {
    for (int64_t i = 0; i < r->soft; i++) {
        r->el[i] += primal * r->del[i];
        r->eu[i] += primal * r->deu[i];
        r->wl[i] -= dual * r->dzl[i];
        r->wu[i] -= dual * r->dzu[i];
    }
}
