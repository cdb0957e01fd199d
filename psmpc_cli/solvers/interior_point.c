/* The steps of the interior-point method: weights of the rows, Newton direction, its length.
 *
 * Each multiplier is proximal: half the square of its change is charged with 1 / stiffness, which bounds the weight a
 * row gets, and vanishes at the solution.
 */

/* What is done to the hard and to the soft limits: `soft` is known when it is compiled. Limits go by value, since
 * compilers take the arrays of a struct behind a pointer for scattered ones. */
#define PART static inline __attribute__((always_inline)) void

/* How far a step reaches: the largest relative decrease of a slack or violation, and of a multiplier; what the
 * complementarity changes by the step of slacks and violations, and by the product of both steps. */
typedef struct {
    double primal, dual, change, product;
} Reach;

PART invert(Limits l, int soft, double least) {
#pragma omp simd
    for (int64_t j = 0; j < l.count; j++) {
        if (soft) l.give[j] = l.e[j] / l.w[j];
        l.inverse[j] = 1.0 / (l.slack[j] + l.z[j] * (soft ? least + l.give[j] : least));
    }
}

/* The multipliers' steps while the rows stay. */
PART aim(Limits l, int soft, double target, double corrected) {
#pragma omp simd
    for (int64_t j = 0; j < l.count; j++) {
        double room = l.room[j];
        if (soft) room += l.way[j] = (target + corrected * l.de[j] * l.dz[j]) / l.w[j];
        l.dz[j] = (target - corrected * l.ds[j] * l.dz[j] - l.z[j] * room) * l.inverse[j];
    }
}

/* The steps of limits that follow from those of the rows. */
PART respond(Limits l, int soft, const double *rows, double least, Reach *reach) {
    double primal = reach->primal, dual = reach->dual, change = reach->change, product = reach->product;
#pragma omp simd reduction(max : primal, dual) reduction(+ : change, product)
    for (int64_t j = 0; j < l.count; j++) {
        double step = l.sign[j] * rows[l.row[j]];
        double dz = l.dz[j] - l.z[j] * l.inverse[j] * step, ds = l.room[j] + step - l.slack[j] + dz * least;
        if (soft) {
            double gives = l.way[j] + l.give[j] * dz, de = gives - l.e[j];
            double a = -de / l.e[j], b = dz / l.w[j];
            primal = primal > a ? primal : a;
            dual = dual > b ? dual : b;
            change += l.w[j] * de;
            product -= de * dz;
            l.de[j] = de;
            ds += gives;
        }
        double a = -ds / l.slack[j], b = -dz / l.z[j];
        primal = primal > a ? primal : a;
        dual = dual > b ? dual : b;
        change += l.z[j] * ds;
        product += ds * dz;
        l.dz[j] = dz;
        l.ds[j] = ds;
    }
    *reach = (Reach){primal, dual, change, product};
}

/* Move, and find the largest residual and the sum of the complementarities. */
PART advance(Limits l, int soft, const double *rows, double primal, double dual, double *residual, double *gap) {
    double worst = *residual, sum = *gap;
#pragma omp simd reduction(max : worst) reduction(+ : sum)
    for (int64_t j = 0; j < l.count; j++) {
        l.room[j] += primal * l.sign[j] * rows[l.row[j]];
        l.slack[j] += primal * l.ds[j];
        l.z[j] += dual * l.dz[j];
        double off = l.room[j] - l.slack[j];
        sum += l.slack[j] * l.z[j];
        if (soft) {
            l.e[j] += primal * l.de[j];
            l.w[j] -= dual * l.dz[j];
            off += l.e[j];
            sum += l.e[j] * l.w[j];
        }
        off = fabs(off);
        worst = worst > off ? worst : off;
    }
    *residual = worst;
    *gap = sum;
}

/* Add to the rows' multipliers those of limits, a share of their step further. */
static void add_multipliers(Limits l, double share, double *q) {
    for (int64_t j = 0; j < l.count; j++) q[l.row[j]] -= l.sign[j] * (l.z[j] + share * l.dz[j]);
}

static void add_weights(Limits l, double *weight) {
    for (int64_t j = 0; j < l.count; j++) weight[l.row[j]] += l.z[j] * l.inverse[j];
}

/* Set the Hessian with the rows' weights. */
static void weigh(Solver *s) {
    const Program *p = s->p;
    double least = 1.0 / s->stiffness;
    invert(s->hard, 0, least);
    invert(s->soft, 1, least);
    memset(s->weight, 0, row_count(p) * sizeof(double));
    add_weights(s->hard, s->weight);
    add_weights(s->soft, s->weight);
    for (int64_t j = 0; j < s->equations.count; j++) s->weight[s->equations.row[j]] = s->stiffness;
    const double *w = s->weight + p->K * M;
    memcpy(s->durations, p->durations, S * S * sizeof(double));
    for (int j = 0; j < S; j++) {
        s->durations[j * S + j] += w[j];
        for (int c = 0; c <= j; c++)
            for (int e = 0; e <= j; e++) s->durations[c * S + e] += w[S + j];
    }
    s->stages.end_weights = w + 2 * S;
    for (int64_t i = 0; i < p->K * N; i++) s->difference[i] = -p->coupling[i];
    if (!p->inputs) return;
    w += 2 * S + p->ends;
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

/* Solve U x = -u by elimination with pivots. Returns 0 where it is singular. */
static int solve_durations(const double *U, const double *u, double *x) {
    double T[S + 1][S + 1];
    for (int i = 0; i < S; i++) {
        memcpy(T[i], U + i * S, S * sizeof(double));
        T[i][S] = -u[i];
    }
    for (int l = 0; l < S; l++) {
        int best = l;
        for (int i = l + 1; i < S; i++)
            if (fabs(T[i][l]) > fabs(T[best][l])) best = i;
        if (!(fabs(T[best][l]) > DBL_MIN)) return 0;
        for (int j = 0; j <= S; j++) {
            double held = T[l][j];
            T[l][j] = T[best][j], T[best][j] = held;
        }
        for (int i = 0; i < S; i++) {
            double f = i == l ? 0.0 : T[i][l] / T[l][l];
            if (f != 0.0)
                for (int j = l; j <= S; j++) T[i][j] -= f * T[l][j];
        }
    }
    for (int i = 0; i < S; i++) x[i] = T[i][S] / T[i][i];
    return 1;
}

/* Derivatives by [Q; v] and by the durations of the costs and of the rows times their multipliers q. */
static void gradient(Solver *s) {
    memcpy(s->lin, s->cost, s->p->K * M * sizeof(double));
    memcpy(s->u, s->cost_tau, S * sizeof(double));
    add_rows(s->p, s->q, s->lin, s->u);
}

/* Newton direction with complementarities towards `target` less the products of the affine step, if `corrected`.
 * Returns 0 where rounding has left none. */
static int direction(Solver *s, double target, double corrected, Reach *reach) {
    const Program *p = s->p;
    Equations *e = &s->equations;
    double least = 1.0 / s->stiffness;
    aim(s->hard, 0, target, corrected);
    aim(s->soft, 1, target, corrected);
    memset(s->q, 0, row_count(p) * sizeof(double));
    add_multipliers(s->hard, 1.0, s->q);
    add_multipliers(s->soft, 1.0, s->q);
    for (int64_t j = 0; j < e->count; j++) s->q[e->row[j]] += e->y[j] + e->off[j] * s->stiffness;
    gradient(s);
    backward(&s->stages, s->intervals, s->lin, s->u, s->y);
    if (!solve_durations(s->U, s->u, s->dtau)) return 0;
    forward(&s->stages, s->intervals, s->dtau, s->y, s->step);
    rows_of(p, s->dtau, s->step);
    *reach = (Reach){1.0, 1.0, 0.0, 0.0};
    respond(s->hard, 0, s->step, least, reach);
    respond(s->soft, 1, s->step, least, reach);
    for (int64_t j = 0; j < e->count; j++) e->dy[j] = (e->off[j] + s->step[e->row[j]]) * s->stiffness;
    return 1;
}

/* Move, and find what is left: the largest residual of limits and equations, and the complementarity. */
static void move(Solver *s, double primal, double dual, double *X, double *tau) {
    Equations *e = &s->equations;
    double worst = 0.0;
    s->gap = 0.0;
    advance(s->hard, 0, s->step, primal, dual, &worst, &s->gap);
    advance(s->soft, 1, s->step, primal, dual, &worst, &s->gap);
    for (int64_t j = 0; j < e->count; j++) {
        e->off[j] += primal * s->step[e->row[j]];
        e->y[j] += dual * e->dy[j];
        worst = fmax(worst, fabs(e->off[j]));
    }
    for (int64_t i = 0; i < s->p->K * M; i++) X[i] += primal * s->step[i];
    for (int c = 0; c < S; c++) tau[c] += primal * s->dtau[c];
    s->residual = worst;
}
/* A primal-dual interior-point method for the quadratic programs of a window, on the recursion in recursion.c.
 *
 * Mehrotra's predictor and corrector, with step lengths of their own for primal and dual. States follow from the steps
 * of velocities and durations by the dynamics, and the multipliers of the gaps from the costs by their adjoint: both
 * hold to rounding at every iterate.
 */

#define STIFFEST 1e9      /* greatest weight a row gets */
#define SOFTEST 1e4       /* the same where rounding has made a Hessian indefinite */
#define TO_BOUNDARY 0.995 /* share of the way to the boundary */
#define CENTER 0.1        /* share of the tolerance that the complementarities are steered to at the end */
#define SHORTEST 1e-9     /* share of a step that gets no further */
#define LONGEST 1e3       /* step of an unbounded unknown that an infeasible program is not asked about */

enum { SOLVED, INFEASIBLE, FAILED };

/* Largest derivative of the Lagrangian by a velocity or a duration, infinite where one is no number; leaves the
 * multipliers of the rows and of the gaps. */
static double dual_residual(Solver *s) {
    const Program *p = s->p;
    double worst = 0.0, sum = 0.0;
    memset(s->q, 0, row_count(p) * sizeof(double));
    for (int64_t j = 0; j < s->equations.count; j++) s->q[s->equations.row[j]] = s->equations.y[j];
    add_multipliers(s->hard, 0.0, s->q);
    add_multipliers(s->soft, 0.0, s->q);
    gradient(s);
    reduce(p, s->lin, s->u, s->adjoint, p->gap_multipliers);
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
static int proves_infeasible(Solver *s) {
    const Program *p = s->p;
    const Limits *l = &s->hard;
    const Equations *e = &s->equations;
    double violated = 0.0, mendable = 0.0;
    for (int64_t j = 0; j < l->count; j++) violated -= l->z[j] * l->room[j];
    for (int64_t j = 0; j < e->count; j++) violated += e->y[j] * e->off[j];
    if (!(violated > 0.0)) return 0;
    memset(s->lin, 0, p->K * M * sizeof(double));
    memset(s->u, 0, S * sizeof(double));
    memset(s->q, 0, row_count(p) * sizeof(double)); /* a soft limit makes nothing infeasible, and bounds no step */
    for (int64_t j = 0; j < e->count; j++) s->q[e->row[j]] = e->y[j];
    add_multipliers(*l, 0.0, s->q);
    add_rows(p, s->q, s->lin, s->u);
    reduce(p, s->lin, s->u, s->adjoint, s->y);
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) {
            int64_t row = k * M + N + i;
            double room = p->soft ? LONGEST : fmax(p->high[row] - p->X[row], p->X[row] - p->low[row]);
            mendable += fmin(room, LONGEST) * fabs(s->adjoint[k * N + i]);
        }
    for (int c = 0; c < S; c++) mendable += LONGEST * fabs(s->u[c]);
    return violated > 2.0 * mendable;
}

static double *take(double **work, int64_t count) {
    double *at = *work;
    *work += PADDED(count + WIDTH);
    return at;
}

/* Lay out limits, at most so many. */
static void lay_out_limits(Limits *l, int64_t most, int soft, double **work) {
    double **arrays[] = {&l->sign, &l->room, &l->slack, &l->z, &l->ds, &l->dz, &l->inverse,
                         &l->e, &l->w, &l->de, &l->give, &l->way};
    l->row = (int64_t *)take(work, most);
    for (int i = 0; i < (soft ? 12 : 7); i++) *arrays[i] = take(work, most);
}

/* Lay out the memory; returns how many numbers it takes. */
static int64_t lay_out(Solver *s, const Program *p, double *work) {
    double *begin = work;
    int64_t rows = row_count(p), K = p->K;
    Equations *e = &s->equations;
    double **of_rows[] = {&s->weight, &s->q, &s->step, &e->off, &e->y, &e->dy};
    lay_out_limits(&s->hard, 2 * rows, 0, &work);
    lay_out_limits(&s->soft, p->soft ? 2 * K * M : 0, 1, &work);
    for (size_t i = 0; i < sizeof of_rows / sizeof *of_rows; i++) *of_rows[i] = take(&work, rows);
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
    double **small[] = {&s->cost_tau, &s->u, &s->dtau, &s->U, &s->durations};
    for (size_t i = 0; i < sizeof small / sizeof *small; i++) *small[i] = take(&work, S * S);
    return work - begin;
}

static int is_equation(const Program *p, int64_t row) {
    return (row >= p->K * M || !p->soft) && p->high[row] - p->low[row] <= NARROW;
}

/* List the limits of some rows; the rows' values stand in the steps. */
static void list_limits(const Solver *s, int64_t first, int64_t last, Limits *l) {
    l->count = 0;
    for (double sign = 1.0; sign >= -1.0; sign -= 2.0)
        for (int64_t i = first; i < last; i++) {
            double bound = sign > 0.0 ? s->p->low[i] : s->p->high[i];
            if (!isfinite(bound) || is_equation(s->p, i)) continue;
            l->row[l->count] = i;
            l->sign[l->count] = sign;
            l->room[l->count++] = sign * (s->step[i] - bound);
        }
}

/* List limits and equations of the rows at the first iterate. */
static void list_rows(Solver *s) {
    const Program *p = s->p;
    int64_t count = row_count(p), soft = p->soft ? p->K * M : 0;
    Equations *e = &s->equations;
    list_limits(s, 0, soft, &s->soft);
    list_limits(s, soft, count, &s->hard);
    e->count = 0;
    for (int64_t i = soft; i < count; i++)
        if (is_equation(p, i)) {
            e->row[e->count] = i;
            e->y[e->count] = e->dy[e->count] = 0.0;
            e->off[e->count++] = s->step[i] - (p->low[i] + p->high[i]) / 2;
        }
}

/* The first slacks and multipliers: all products are the barrier, which grows with what the limits are violated by. */
static void begin_limits(Solver *s) {
    const Program *p = s->p;
    double push = p->push, barrier = p->barrier;
    Limits *l = &s->hard;
    for (int64_t j = 0; j < l->count; j++) push = fmax(push, -l->room[j]);
    for (int64_t j = 0; j < s->equations.count; j++) push = fmax(push, fabs(s->equations.off[j]));
    barrier *= push / p->push;
    int64_t inputs = p->K * M + 2 * S + p->ends, shift = p->K * N;
    for (int64_t j = 0; j < l->count; j++) {
        int64_t low = l->row[j], high = low;
        if (low >= inputs + shift) low -= shift; /* an acceleration has a row for each of its limits */
        else if (low >= inputs) high += shift;
        double width = p->high[high] - p->low[low] + (s->step[low] - s->step[high]);
        l->slack[j] = fmax(l->room[j], fmin(push, width / 4));
        l->z[j] = barrier / l->slack[j];
        l->ds[j] = l->dz[j] = 0.0;
    }
    l = &s->soft;
    for (int64_t j = 0; j < l->count; j++) {
        double penalty = p->penalty[l->row[j] / M];
        l->e[j] = fmax(p->push - l->room[j], barrier / penalty);
        l->slack[j] = l->room[j] + l->e[j];
        l->z[j] = fmin(barrier / l->slack[j], penalty / 2);
        l->w[j] = penalty - l->z[j];
        l->ds[j] = l->dz[j] = l->de[j] = 0.0;
    }
}

static void begin(Solver *s) {
    const Program *p = s->p;
    double drift[N] = {0};
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
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) p->X[k * M + i] = drift[i] -= p->gaps[k * N + i];
    memcpy(s->step, p->X, p->K * M * sizeof(double));
    rows_of(p, p->tau, s->step);
    list_rows(s);
    begin_limits(s);
    memset(s->dtau, 0, S * sizeof(double));
    move(s, 0.0, 0.0, p->X, p->tau);
}

/* Bytes of a Program, which who calls from another language declares again. */
int64_t psmpc_qp_program_size(void) {
    return (int64_t)sizeof(Program);
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
static int iterate(Solver *s, double limits, int alike) {
    const Program *p = s->p;
    Reach r;
    if (!factorize_safely(s) || !direction(s, 0.0, 0.0, &r)) return 0;
    double primal = 1.0 / r.primal, dual = 1.0 / r.dual, least = CENTER * p->tolerance / limits, mu = s->gap / limits;
    double left = (1.0 - dual) * s->gap + (primal - dual) * r.change + primal * dual * r.product;
    double share = s->gap > 0.0 ? left / s->gap : 0.0;
    if (!direction(s, fmax(share * share * share * mu, least), 1.0, &r)) return 0;
    primal = r.primal > 1.0 ? TO_BOUNDARY / r.primal : 1.0;
    dual = r.dual > 1.0 ? TO_BOUNDARY / r.dual : 1.0;
    if (alike) primal = dual = fmin(primal, dual);
    move(s, primal, dual, p->X, p->tau);
    return primal > SHORTEST || dual > SHORTEST;
}

int64_t psmpc_qp_solve(const Program *p) {
    Solver s;
    double before = INFINITY;
    int alike = 0;
    lay_out(&s, p, p->work);
    begin(&s);
    double limits = fmax((double)(s.hard.count + 2 * s.soft.count), 1.0);
    for (int64_t count = 0;; count++) {
        cost_gradient(&s, p->X, p->tau);
        double gap = s.gap, primal = s.residual, dual = dual_residual(&s);
        double worst = fmax(fmax(primal, dual), gap);
        p->report[0] = (double)count, p->report[1] = primal, p->report[2] = dual, p->report[3] = gap;
        memcpy(p->multipliers, s.q, row_count(p) * sizeof(double));
        if (!isfinite(worst)) return FAILED;
        if (worst <= p->tolerance) return SOLVED;
        if (primal > p->tolerance && proves_infeasible(&s)) return INFEASIBLE;
        /* Steps of two lengths may throw the gradient about; steps of one length lessen every residual. */
        alike |= primal <= p->nearly && fmax(dual, gap) > before;
        before = fmax(dual, gap);
        if (count == p->limit || !iterate(&s, limits, alike))
            return worst <= p->nearly ? SOLVED : FAILED;
    }
}
