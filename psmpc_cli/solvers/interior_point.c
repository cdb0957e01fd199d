/* The steps of the interior-point method: weights of the rows, Newton direction, its length.
 *
 * Each multiplier is proximal: half the square of its change is charged with 1 / stiffness, which bounds the weight a
 * row gets, and vanishes at the solution.
 */

/* Set the Hessian with the rows' weights. */
static void weigh(Solver *s) {
    const Program *p = s->p;
    Limits *l = &s->limits;
    double least = 1.0 / s->stiffness;
#pragma omp simd
    for (int64_t j = l->soft; j < l->count; j++) l->inverse[j] = 1.0 / (l->slack[j] + l->z[j] * least);
    weigh_soft(l, least);
    memset(s->weight, 0, row_count(p) * sizeof(double));
    for (int64_t j = 0; j < l->count; j++) s->weight[l->row[j]] += l->z[j] * l->inverse[j];
    for (int64_t j = 0; j < s->equations.count; j++) s->weight[s->equations.row[j]] = s->stiffness;
    const double *w = s->weight + p->K * M;
    memcpy(s->durations, p->durations, S * S * sizeof(double));
    for (int c = 0; c < S; c++) {
        s->durations[c * S + c] += w[c];
        for (int e = 0; e < S; e++) s->durations[c * S + e] += w[S];
    }
    s->stages.end_weights = w + S + 1;
    for (int64_t i = 0; i < p->K * N; i++) s->difference[i] = -p->coupling[i];
    if (!p->inputs) return;
    w += S + 1 + p->ends;
    memcpy(s->arrow, p->arrow, p->K * M * S * sizeof(double));
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) {
            double low = w[k * N + i], high = w[(p->K + k) * N + i];
            double l = p->input_low[k * N + i], h = p->input_high[k * N + i];
            s->difference[k * N + i] += low + high;
            for (int c = 0; c < S; c++) {
                double cross = (low * l + high * h) * p->share[k * S + c];
                s->arrow[(k * M + N + i) * S + c] -= cross;
                if (k) s->arrow[((k - 1) * M + N + i) * S + c] += cross;
                for (int e = 0; e < S; e++)
                    s->durations[c * S + e] += (low * l * l + high * h * h) * p->share[k * S + c] * p->share[k * S + e];
            }
        }
}

/* Solve [U A'; A -1/stiffness] [x; n] = [-u; r] by elimination with pivots. Returns 0 where it is singular. */
static int solve_durations(const Program *p, const double *U, const double *u, const double *r, double stiffness,
                           double *x, double *n) {
    int size = S + (int)p->given, width = size + 1;
    double T[3 * S + 1][3 * S + 2];
    for (int i = 0; i < size; i++)
        for (int j = 0; j < width; j++) T[i][j] = 0.0;
    for (int i = 0; i < S; i++) {
        for (int j = 0; j < S; j++) T[i][j] = U[i * S + j];
        T[i][size] = -u[i];
    }
    for (int e = 0; e < (int)p->given; e++) {
        for (int j = 0; j < S; j++) T[S + e][j] = T[j][S + e] = p->given_rows[e * S + j];
        T[S + e][S + e] = -1.0 / stiffness;
        T[S + e][size] = r[e];
    }
    for (int l = 0; l < size; l++) {
        int best = l;
        for (int i = l + 1; i < size; i++)
            if (fabs(T[i][l]) > fabs(T[best][l])) best = i;
        if (!(fabs(T[best][l]) > DBL_MIN)) return 0;
        for (int j = 0; j < width; j++) {
            double held = T[l][j];
            T[l][j] = T[best][j], T[best][j] = held;
        }
        for (int i = 0; i < size; i++) {
            double f = i == l ? 0.0 : T[i][l] / T[l][l];
            if (f != 0.0)
                for (int j = l; j < width; j++) T[i][j] -= f * T[l][j];
        }
    }
    for (int i = 0; i < S; i++) x[i] = T[i][size] / T[i][i];
    for (int e = 0; e < (int)p->given; e++) n[e] = T[S + e][size] / T[S + e][S + e];
    return 1;
}

/* Derivatives by [Q; v] and by the durations of the costs and of the rows times their multipliers q. */
static void gradient(Solver *s) {
    memcpy(s->lin, s->cost, s->p->K * M * sizeof(double));
    memcpy(s->u, s->cost_tau, S * sizeof(double));
    add_rows(s->p, s->q, s->lin, s->u);
}

/* Newton direction with complementarities towards `target` less the products of the affine step, if `corrected`. */
static int direction(Solver *s, const double *tau, double target, double corrected) {
    const Program *p = s->p;
    Limits *l = &s->limits;
    Equations *e = &s->equations;
    double residual[2 * S + 1], least = 1.0 / s->stiffness;
    give_way(l, target, corrected);
#pragma omp simd
    for (int64_t j = 0; j < l->count; j++) { /* the multipliers' steps while the rows stay */
        double room = l->room[j] + (j < l->soft ? l->way[j] : 0.0);
        l->dz[j] = (target - corrected * l->ds[j] * l->dz[j] - l->z[j] * room) * l->inverse[j];
    }
    memset(s->q, 0, row_count(p) * sizeof(double));
    for (int64_t j = 0; j < l->count; j++) s->q[l->row[j]] -= l->sign[j] * (l->z[j] + l->dz[j]);
    for (int64_t j = 0; j < e->count; j++) s->q[e->row[j]] += e->y[j] + e->off[j] * s->stiffness;
    gradient(s);
    add_given(p, s->nu, s->u);
    for (int i = 0; i < (int)p->given; i++) residual[i] = given_left(p, tau, i);
    backward(&s->stages, s->intervals, s->lin, s->u, s->y);
    if (!solve_durations(p, s->U, s->u, residual, s->stiffness, s->dtau, s->dnu)) return 0;
    forward(&s->stages, s->intervals, s->dtau, s->y, s->step);
    rows_of(p, s->dtau, s->step);
#pragma omp simd
    for (int64_t j = 0; j < l->count; j++) {
        double step = l->sign[j] * s->step[l->row[j]];
        l->dz[j] -= l->z[j] * l->inverse[j] * step;
        l->ds[j] = l->room[j] + step - l->slack[j] + l->dz[j] * least;
    }
    direct_soft(l);
    for (int64_t j = 0; j < e->count; j++) e->dy[j] = (e->off[j] + s->step[e->row[j]]) * s->stiffness;
    return 1;
}

/* Longest shares of the step that keep slacks and multipliers positive. */
static void longest(const Limits *l, double *primal, double *dual) {
    double s = 0.0, z = 0.0;
#pragma omp simd reduction(max : s, z)
    for (int64_t j = 0; j < l->count; j++) {
        double a = -l->ds[j] / l->slack[j], b = -l->dz[j] / l->z[j];
        s = s > a ? s : a;
        z = z > b ? z : b;
    }
    shrink_soft(l, &s, &z);
    *primal = 1.0 / (s > 1.0 ? s : 1.0);
    *dual = 1.0 / (z > 1.0 ? z : 1.0);
}

static double complementarity(const Limits *l, double primal, double dual) {
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (int64_t j = 0; j < l->count; j++)
        sum += (l->slack[j] + primal * l->ds[j]) * (l->z[j] + dual * l->dz[j]);
    return sum + soft_complementarity(l, primal, dual);
}

static void move(Solver *s, double primal, double dual, double *X, double *tau) {
    Limits *l = &s->limits;
    Equations *e = &s->equations;
    move_soft(l, primal, dual);
#pragma omp simd
    for (int64_t j = 0; j < l->count; j++) {
        l->room[j] += primal * l->sign[j] * s->step[l->row[j]];
        l->slack[j] += primal * l->ds[j];
        l->z[j] += dual * l->dz[j];
    }
    for (int64_t j = 0; j < e->count; j++) {
        e->off[j] += primal * s->step[e->row[j]];
        e->y[j] += dual * e->dy[j];
    }
    for (int64_t i = 0; i < s->p->K * M; i++) X[i] += primal * s->step[i];
    for (int c = 0; c < S; c++) tau[c] += primal * s->dtau[c];
    for (int i = 0; i < (int)s->p->given; i++) s->nu[i] += dual * s->dnu[i];
}
/* A primal-dual interior-point method for the quadratic programs of a window, on the recursion in recursion.c.
 *
 * Mehrotra's predictor and corrector, with step lengths of their own for primal and dual. States follow from the steps
 * of velocities and durations by the dynamics, and the multipliers of the gaps from the costs by their adjoint: both
 * hold to rounding at every iterate.
 */

#define STIFFEST 1e9      /* greatest weight a row gets */
#define SOFTEST 1e4       /* the same where rounding has made a Hessian indefinite */
#define NARROW 1e-8       /* rows with low and high nearer than this are equations */
#define TO_BOUNDARY 0.995 /* share of the way to the boundary */
#define CENTER 0.1        /* share of the tolerance that the complementarities are steered to at the end */
#define SHORTEST 1e-9     /* share of a step that gets no further */
#define LONGEST 1e3       /* step of an unbounded unknown that an infeasible program is not asked about */

enum { SOLVED, INFEASIBLE, FAILED };

static double primal_residual(const Solver *s, const double *tau) {
    const Limits *l = &s->limits;
    double worst = soft_residual(l);
#pragma omp simd reduction(max : worst)
    for (int64_t j = l->soft; j < l->count; j++) {
        double off = fabs(l->room[j] - l->slack[j]);
        worst = worst > off ? worst : off;
    }
    for (int64_t j = 0; j < s->equations.count; j++) worst = fmax(worst, fabs(s->equations.off[j]));
    for (int i = 0; i < (int)s->p->given; i++) worst = fmax(worst, fabs(given_left(s->p, tau, i)));
    return worst;
}

/* Set the rows' multipliers to those of limits from a first one on, and of equations. */
static void multipliers(Solver *s, int64_t first) {
    const Limits *l = &s->limits;
    memset(s->q, 0, row_count(s->p) * sizeof(double));
    for (int64_t j = first; j < l->count; j++) s->q[l->row[j]] -= l->sign[j] * l->z[j];
    for (int64_t j = 0; j < s->equations.count; j++) s->q[s->equations.row[j]] += s->equations.y[j];
}

/* Largest derivative of the Lagrangian by a velocity or a duration, infinite where one is no number; leaves the
 * multipliers of the rows and of the gaps. */
static double dual_residual(Solver *s) {
    const Program *p = s->p;
    double worst = 0.0, sum = 0.0;
    multipliers(s, 0);
    gradient(s);
    reduce(p, s->lin, s->u, s->adjoint, p->gap_multipliers);
    add_given(p, s->nu, s->u);
    for (int c = 0; c < S; c++) worst = fmax(worst, fabs(s->u[c])), sum += s->u[c];
#pragma omp simd reduction(max : worst) reduction(+ : sum)
    for (int64_t i = 0; i < p->K * N; i++) {
        double size = fabs(s->adjoint[i]);
        worst = worst > size ? worst : size;
        sum += size;
    }
    return isfinite(sum) ? worst : INFINITY;
}

/* Whether the multipliers prove that no point meets all rows: their combination of the rows is violated at the
 * iterate by more than any step inside the bounds can mend. Farkas' lemma, with room for rounding. */
static int proves_infeasible(Solver *s, const double *tau) {
    const Program *p = s->p;
    const Limits *l = &s->limits;
    const Equations *e = &s->equations;
    double violated = 0.0, mendable = 0.0;
    for (int64_t j = l->soft; j < l->count; j++) violated -= l->z[j] * l->room[j];
    for (int64_t j = 0; j < e->count; j++) violated += e->y[j] * e->off[j];
    for (int i = 0; i < (int)p->given; i++) violated -= s->nu[i] * given_left(p, tau, i);
    if (!(violated > 0.0)) return 0;
    memset(s->lin, 0, p->K * M * sizeof(double));
    memset(s->u, 0, S * sizeof(double));
    multipliers(s, l->soft); /* a soft limit makes nothing infeasible, and bounds no step */
    add_rows(p, s->q, s->lin, s->u);
    reduce(p, s->lin, s->u, s->adjoint, s->y);
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) {
            int64_t row = k * M + N + i;
            double room = p->soft ? LONGEST : fmax(p->high[row] - p->X[row], p->X[row] - p->low[row]);
            mendable += fmin(fabs(room), LONGEST) * fabs(s->adjoint[k * N + i]);
        }
    add_given(p, s->nu, s->u);
    for (int c = 0; c < S; c++) mendable += LONGEST * fabs(s->u[c]);
    return violated > 2.0 * mendable;
}

static double *take(double **work, int64_t count) {
    double *at = *work;
    *work += PADDED(count + WIDTH);
    return at;
}

/* Lay out the memory; returns how many numbers it takes. */
static int64_t lay_out(Solver *s, const Program *p, double *work) {
    double *begin = work;
    int64_t rows = row_count(p), K = p->K, soft = p->soft ? 2 * K * M : 0;
    Limits *l = &s->limits;
    Equations *e = &s->equations;
    double **limits[] = {&l->sign, &l->room, &l->slack, &l->z, &l->ds, &l->dz, &l->inverse};
    double **softs[] = {&l->e, &l->w, &l->de, &l->give, &l->way};
    double **of_rows[] = {&s->weight, &s->q, &s->step, &e->off, &e->y, &e->dy};
    for (size_t i = 0; i < sizeof limits / sizeof *limits; i++) *limits[i] = take(&work, 2 * rows);
    for (size_t i = 0; i < sizeof softs / sizeof *softs; i++) *softs[i] = take(&work, soft);
    for (size_t i = 0; i < sizeof of_rows / sizeof *of_rows; i++) *of_rows[i] = take(&work, rows);
    l->row = (int64_t *)take(&work, 2 * rows);
    e->row = (int64_t *)take(&work, rows);
    s->p = p;
    s->intervals = (Interval *)take(&work, K * (int64_t)(sizeof(Interval) / sizeof(double)));
    s->positions = (vec *)take(&work, K * N * NC);
    s->y = take(&work, K * NC);
    s->cost = take(&work, K * M);
    s->lin = take(&work, K * M);
    s->adjoint = take(&work, K * N);
    s->difference = take(&work, K * N);
    s->arrow = take(&work, K * M * S);
    double **small[] = {&s->cost_tau, &s->u, &s->dtau, &s->nu, &s->dnu, &s->U, &s->durations};
    for (size_t i = 0; i < sizeof small / sizeof *small; i++) *small[i] = take(&work, (S + 1) * (S + 1) + 2 * S);
    return work - begin;
}

static int is_equation(const Program *p, int64_t row) {
    return (row >= p->K * M || !p->soft) && p->high[row] - p->low[row] <= NARROW;
}

/* List the limits of some rows from one side; the rows' values stand in the steps. */
static void list_limits(Solver *s, int64_t first, int64_t last, double sign) {
    const double *bounds = sign > 0.0 ? s->p->low : s->p->high;
    Limits *l = &s->limits;
    for (int64_t i = first; i < last; i++) {
        if (!isfinite(bounds[i]) || is_equation(s->p, i)) continue;
        l->row[l->count] = i;
        l->sign[l->count] = sign;
        l->room[l->count++] = sign * (s->step[i] - bounds[i]);
    }
}

/* List limits and equations of the rows at the first iterate, soft limits first. */
static void list_rows(Solver *s) {
    const Program *p = s->p;
    int64_t count = row_count(p), soft = p->soft ? p->K * M : 0;
    Equations *e = &s->equations;
    s->limits.count = e->count = 0;
    list_limits(s, 0, soft, 1.0);
    list_limits(s, 0, soft, -1.0);
    s->limits.soft = s->limits.count;
    list_limits(s, soft, count, 1.0);
    list_limits(s, soft, count, -1.0);
    for (int64_t i = soft; i < count; i++)
        if (is_equation(p, i)) {
            e->row[e->count] = i;
            e->y[e->count] = 0.0;
            e->off[e->count++] = s->step[i] - (p->low[i] + p->high[i]) / 2;
        }
}

static void begin(Solver *s) {
    const Program *p = s->p;
    Limits *l = &s->limits;
    double shift[N] = {0};
    s->stiffness = STIFFEST;
    s->stages = (Stages){.K = p->K, .positions = s->positions, .diagonal = s->weight,
                         .arrow = p->inputs ? s->arrow : p->arrow, .durations = s->durations,
                         .difference = s->difference, .gap_velocity = p->gap_velocity, .gap_tau = p->gap_tau,
                         .ends = p->ends, .end_node = p->end_node, .end_rows = p->end_rows};
    memset(s->positions, 0, p->K * N * NC * sizeof(double));
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++)
            for (int j = i; j < N; j++)
                numbers(s->positions + (k * N + i) * NV)[j] = numbers(s->positions + (k * N + j) * NV)[i] =
                    p->positions[(k * N + i) * N + j];
    memset(p->X, 0, p->K * M * sizeof(double));
    memset(p->tau, 0, S * sizeof(double));
    memset(s->nu, 0, p->given * sizeof(double));
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) p->X[k * M + i] = shift[i] -= p->gaps[k * N + i];
    memcpy(s->step, p->X, p->K * M * sizeof(double));
    rows_of(p, p->tau, s->step);
    list_rows(s);
    double push = p->push, barrier = p->barrier;
    for (int64_t j = l->soft; j < l->count; j++) push = fmax(push, -l->room[j]);
    for (int64_t j = 0; j < s->equations.count; j++) push = fmax(push, fabs(s->equations.off[j]));
    barrier *= push / p->push;
    for (int64_t j = 0; j < l->count; j++) {
        double width = p->high[l->row[j]] - p->low[l->row[j]];
        l->slack[j] = fmax(l->room[j], fmin(push, width / 4));
        l->z[j] = barrier / l->slack[j];
        l->ds[j] = l->dz[j] = 0.0;
    }
    begin_soft(l, p->penalty, p->push, barrier);
}

int64_t psmpc_qp_memory(const Program *p) {
    Solver s;
    return lay_out(&s, p, NULL);
}

/* Factorize the Hessian with the rows' weights, looser ones where rounding has made it indefinite. */
static int factorize_safely(Solver *s) {
    for (; s->stiffness > SOFTEST; s->stiffness /= 10.0) {
        weigh(s);
        if (factorize(&s->stages, s->intervals, s->U)) return 1;
    }
    return 0;
}

/* Predictor, corrector and step, of one length where `alike`. Returns 0 where rounding has left no direction. */
static int iterate(Solver *s, double limits, double gap, int alike) {
    const Program *p = s->p;
    double primal, dual, mu = gap / limits;
    if (!factorize_safely(s) || !direction(s, p->tau, 0.0, 0.0)) return 0;
    longest(&s->limits, &primal, &dual);
    double share = gap > 0.0 ? complementarity(&s->limits, primal, dual) / gap : 0.0;
    if (!direction(s, p->tau, fmax(share * share * share * mu, CENTER * p->tolerance / limits), 1.0)) return 0;
    longest(&s->limits, &primal, &dual);
    primal = primal < 1.0 ? TO_BOUNDARY * primal : 1.0;
    dual = dual < 1.0 ? TO_BOUNDARY * dual : 1.0;
    if (alike) primal = dual = fmin(primal, dual);
    move(s, primal, dual, p->X, p->tau);
    return primal > SHORTEST || dual > SHORTEST;
}

int64_t psmpc_qp_solve(const Program *p) {
    Solver s;
    Limits *l = &s.limits;
    double before = INFINITY;
    int alike = 0;
    lay_out(&s, p, p->work);
    begin(&s);
    double limits = fmax((double)(l->count + l->soft), 1.0);
    for (int64_t count = 0;; count++) {
        cost_gradient(&s, p->X, p->tau);
        double gap = complementarity(l, 0.0, 0.0), primal = primal_residual(&s, p->tau), dual = dual_residual(&s);
        double worst = fmax(fmax(primal, dual), gap);
        p->report[0] = (double)count, p->report[1] = primal, p->report[2] = dual, p->report[3] = gap;
        memcpy(p->multipliers, s.q, row_count(p) * sizeof(double));
        memcpy(p->given_multipliers, s.nu, p->given * sizeof(double));
        if (!isfinite(worst)) return FAILED;
        if (worst <= p->tolerance) return SOLVED;
        if (primal > p->tolerance && proves_infeasible(&s, p->tau)) return INFEASIBLE;
        /* Steps of two lengths may throw the gradient about; steps of one length lessen every residual. */
        alike |= primal <= p->nearly && fmax(dual, gap) > before;
        before = fmax(dual, gap);
        if (count == p->limit || !iterate(&s, limits, gap, alike))
            return worst <= p->nearly ? SOLVED : FAILED;
    }
}
