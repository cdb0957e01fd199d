/* The steps of the interior-point method: weights of the rows, Newton direction, its length.
 *
 * Multipliers are proximal: half the square of their change is charged with rho = 1 / max_weight, which bounds the
 * weight that a row gets in the Hessian, and vanishes at the solution. The Newton equations of a limit are so
 *
 *     d + C dx - (s + ds) + rho dz = 0,   s dz + z ds = mu - s z - ds_a dz_a,
 *
 * with the products of the affine step (ds_a, dz_a) in Mehrotra's corrector. Eliminating ds,
 *
 *     dz = (mu - ds_a dz_a - z (d + C dx)) / (s + rho z),
 *
 * which adds the weight z / (s + rho z) to the Hessian by the row. Nocedal, Wright: Numerical Optimization (2006),
 * sections 16.6 and 19.3.
 */

/* Functions of the hard and of the soft limits: `soft` is known when they are compiled. Limits go by value, since
 * compilers take the arrays of a struct behind a pointer for scattered ones. */
#define INLINED static inline __attribute__((always_inline)) void

/* What bounds the lengths of a step: the largest relative decrease of a slack or violation (primal) and of a multiplier
 * (dual), max of -ds / s and -dz / z. `change` is the sum of z ds, `product` that of ds dz, with which the
 * complementarity after a step of any lengths is known. */
typedef struct {
    double primal, dual, change, product;
} StepLengths;

INLINED update_scaling(Limits l, int soft, double regularization) {
#pragma omp simd
    for (int64_t j = 0; j < l.count; j++) {
        if (soft) l.relaxation[j] = l.e[j] / l.w[j];
        double rho = soft ? regularization + l.relaxation[j] : regularization;
        l.inverse_diagonal[j] = 1.0 / (l.slack[j] + l.z[j] * rho);
    }
}

/* Set dz to its part without C dx, (mu - ds_a dz_a - z d) / (s + rho z); `corrected` is 1 with the corrector, else 0.
 * */
INLINED form_right_hand_side(Limits l, int soft, double target, double corrected) {
#pragma omp simd
    for (int64_t j = 0; j < l.count; j++) {
        double distance = l.distance[j];
        if (soft) distance += l.relaxation_shift[j] = (target + corrected * l.de[j] * l.dz[j]) / l.w[j];
        l.dz[j] = (target - corrected * l.ds[j] * l.dz[j] - l.z[j] * distance) * l.inverse_diagonal[j];
    }
}

/* Recover dz, ds and de from the steps C dx of the rows, and what bounds the lengths of the step. */
INLINED recover_steps(Limits l, int soft, const double *rows, double regularization, StepLengths *lengths) {
    double primal = lengths->primal;
    double dual = lengths->dual;
    double change = lengths->change;
    double product = lengths->product;
#pragma omp simd reduction(max : primal, dual) reduction(+ : change, product)
    for (int64_t j = 0; j < l.count; j++) {
        double step = l.sign[j] * rows[l.row[j]];
        double dz = l.dz[j] - l.z[j] * l.inverse_diagonal[j] * step;
        double ds = l.distance[j] + step - l.slack[j] + dz * regularization;
        if (soft) {
            double gives = l.relaxation_shift[j] + l.relaxation[j] * dz;
            double de = gives - l.e[j];
            double a = -de / l.e[j];
            double b = dz / l.w[j];
            primal = primal > a ? primal : a;
            dual = dual > b ? dual : b;
            change += l.w[j] * de;
            product -= de * dz;
            l.de[j] = de;
            ds += gives;
        }
        double a = -ds / l.slack[j];
        double b = -dz / l.z[j];
        primal = primal > a ? primal : a;
        dual = dual > b ? dual : b;
        change += l.z[j] * ds;
        product += ds * dz;
        l.dz[j] = dz;
        l.ds[j] = ds;
    }
    *lengths = (StepLengths){primal, dual, change, product};
}

/* Take a step of the lengths `primal` and `dual`; update the largest residual |d + e - s| and the sum of s z and e w.
 * */
INLINED advance_limits(Limits l, int soft, const double *rows, double primal, double dual, double *residual,
                       double *gap) {
    double largest = *residual;
    double sum = *gap;
#pragma omp simd reduction(max : largest) reduction(+ : sum)
    for (int64_t j = 0; j < l.count; j++) {
        l.distance[j] += primal * l.sign[j] * rows[l.row[j]];
        l.slack[j] += primal * l.ds[j];
        l.z[j] += dual * l.dz[j];
        double infeasibility = l.distance[j] - l.slack[j];
        sum += l.slack[j] * l.z[j];
        if (soft) {
            l.e[j] += primal * l.de[j];
            l.w[j] -= dual * l.dz[j];
            infeasibility += l.e[j];
            sum += l.e[j] * l.w[j];
        }
        infeasibility = fabs(infeasibility);
        largest = largest > infeasibility ? largest : infeasibility;
    }
    *residual = largest;
    *gap = sum;
}

/* Subtract the multipliers of limits, a share of their step further, from those of the rows: -sign (z + share dz). */
static void add_multipliers(Limits l, double share, double *q) {
    for (int64_t j = 0; j < l.count; j++) q[l.row[j]] -= l.sign[j] * (l.z[j] + share * l.dz[j]);
}

static void add_weights(Limits l, double *weight) {
    for (int64_t j = 0; j < l.count; j++) weight[l.row[j]] += l.z[j] * l.inverse_diagonal[j];
}

/* Form H + C'W C with the weights W of the rows: z / (s + rho z) of a limit, max_weight of an equation. */
static void form_hessian(Solver *s) {
    const Program *p = s->p;
    double regularization = 1.0 / s->max_weight;
    update_scaling(s->hard, 0, regularization);
    update_scaling(s->soft, 1, regularization);
    memset(s->weight, 0, row_count(p) * sizeof(double));
    add_weights(s->hard, s->weight);
    add_weights(s->soft, s->weight);
    for (int64_t j = 0; j < s->equations.count; j++) s->weight[s->equations.row[j]] = s->max_weight;
    const double *w = s->weight + p->K * M;
    memcpy(s->durations, p->durations, S * S * sizeof(double));
    for (int j = 0; j < S; j++) {
        s->durations[j * S + j] += w[j];
        for (int c = 0; c <= j; c++)
            for (int e = 0; e <= j; e++) s->durations[c * S + e] += w[S + j];
    }
    s->riccati.row_weights = w + 2 * S;
    for (int64_t i = 0; i < p->K * N; i++) s->difference[i] = -p->coupling[i];
    if (!p->inputs) return;
    w += 2 * S + p->node_rows;
    memcpy(s->arrow, p->arrow, p->K * M * S * sizeof(double));
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) {
            double low = w[k * N + i];
            double high = w[(p->K + k) * N + i];
            double l = p->input_low[k * N + i];
            double h = p->input_high[k * N + i];
            s->difference[k * N + i] += low + high;
            for (int c = 0; c < S; c++) {
                double cross = (low * l + high * h) * p->interval_by_duration[k * S + c];
                s->arrow[(k * M + N + i) * S + c] -= cross;
                if (k) s->arrow[((k - 1) * M + N + i) * S + c] += cross;
                double by_duration = (low * l * l + high * h * h) * p->interval_by_duration[k * S + c];
                for (int e = 0; e < S; e++)
                    s->durations[c * S + e] += by_duration * p->interval_by_duration[k * S + e];
            }
        }
}

/* Solve U x = -u for the steps of the durations, by Gauss-Jordan elimination with pivots. Returns 0 where U is
 * singular. */
static int solve_schur(const double *schur, const double *u, double *x) {
    double T[S + 1][S + 1];
    for (int i = 0; i < S; i++) {
        memcpy(T[i], schur + i * S, S * sizeof(double));
        T[i][S] = -u[i];
    }
    for (int l = 0; l < S; l++) {
        int best = l;
        for (int i = l + 1; i < S; i++)
            if (fabs(T[i][l]) > fabs(T[best][l])) best = i;
        if (!(fabs(T[best][l]) > DBL_MIN)) return 0;
        for (int j = 0; j <= S; j++) {
            double held = T[l][j];
            T[l][j] = T[best][j];
            T[best][j] = held;
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

/* Compute the gradient of the Lagrangian without the dynamics: that of the objective plus C'q. */
static void gradient(Solver *s) {
    memcpy(s->gradient_X, s->cost, s->p->K * M * sizeof(double));
    memcpy(s->u, s->cost_tau, S * sizeof(double));
    add_rows_transposed(s->p, s->q, s->gradient_X, s->u);
}

/* Compute the Newton direction towards complementarities of `target` = mu, with Mehrotra's corrector if `corrected`:
 * solve
 *
 *     (H + C'W C) dx = -(H x + g + C'q),   q = -sign (z + dz at dx = 0) of limits, y + max_weight residual of
 * equations,
 *
 * by the Riccati sweeps, the durations last. Returns 0 where rounding has left no direction. */
static int newton_direction(Solver *s, double target, double corrected, StepLengths *lengths) {
    const Program *p = s->p;
    Equations *e = &s->equations;
    double regularization = 1.0 / s->max_weight;
    form_right_hand_side(s->hard, 0, target, corrected);
    form_right_hand_side(s->soft, 1, target, corrected);
    memset(s->q, 0, row_count(p) * sizeof(double));
    add_multipliers(s->hard, 1.0, s->q);
    add_multipliers(s->soft, 1.0, s->q);
    for (int64_t j = 0; j < e->count; j++) s->q[e->row[j]] += e->y[j] + e->residual[j] * s->max_weight;
    gradient(s);
    riccati_backward(&s->riccati, s->intervals, s->gradient_X, s->u, s->y);
    if (!solve_schur(s->schur, s->u, s->dtau)) return 0;
    riccati_forward(&s->riccati, s->intervals, s->dtau, s->y, s->step);
    apply_rows(p, s->dtau, s->step);
    *lengths = (StepLengths){1.0, 1.0, 0.0, 0.0};
    recover_steps(s->hard, 0, s->step, regularization, lengths);
    recover_steps(s->soft, 1, s->step, regularization, lengths);
    for (int64_t j = 0; j < e->count; j++) e->dy[j] = (e->residual[j] + s->step[e->row[j]]) * s->max_weight;
    return 1;
}

/* Take a step of the lengths `primal` and `dual`; update residuals and complementarity. */
static void take_step(Solver *s, double primal, double dual, double *X, double *tau) {
    Equations *e = &s->equations;
    double largest = 0.0;
    s->gap = 0.0;
    advance_limits(s->hard, 0, s->step, primal, dual, &largest, &s->gap);
    advance_limits(s->soft, 1, s->step, primal, dual, &largest, &s->gap);
    for (int64_t j = 0; j < e->count; j++) {
        e->residual[j] += primal * s->step[e->row[j]];
        e->y[j] += dual * e->dy[j];
        largest = fmax(largest, fabs(e->residual[j]));
    }
    for (int64_t i = 0; i < s->p->K * M; i++) X[i] += primal * s->step[i];
    for (int c = 0; c < S; c++) tau[c] += primal * s->dtau[c];
    s->residual = largest;
}
/* A primal-dual interior-point method for the quadratic programs of a window, on the recursion in recursion.c.
 *
 * Mehrotra's predictor and corrector, with step lengths of their own for primal and dual. States follow from the steps
 * of velocities and durations by the dynamics, and the multipliers of the gaps from the costs by their adjoint: both
 * hold to rounding at every iterate.
 */

#define MAX_ROW_WEIGHT 1e9      /* greatest weight of a row in the Hessian */
#define MIN_ROW_WEIGHT 1e4       /* the same where rounding has made a Hessian indefinite */
#define FRACTION_TO_BOUNDARY 0.995 /* largest share of the way to where a slack or multiplier is 0 */
#define FINAL_CENTERING 0.1        /* share of the tolerance that complementarities are steered to at the end */
#define MIN_STEP_LENGTH 1e-9     /* shortest length of a step that still gets anywhere */
#define UNBOUNDED_STEP 1e3       /* step of an unbounded unknown that an infeasible program is not asked about */

enum { SOLVED, INFEASIBLE, FAILED };

/* Return the largest derivative of the Lagrangian by a velocity or a duration, infinite where one is no number. Leaves
 * the multipliers of the rows and of the gaps. */
static double dual_residual(Solver *s) {
    const Program *p = s->p;
    double largest = 0.0;
    double sum = 0.0;
    memset(s->q, 0, row_count(p) * sizeof(double));
    for (int64_t j = 0; j < s->equations.count; j++) s->q[s->equations.row[j]] = s->equations.y[j];
    add_multipliers(s->hard, 0.0, s->q);
    add_multipliers(s->soft, 0.0, s->q);
    gradient(s);
    reduced_gradient(p, s->gradient_X, s->u, s->gradient_velocity, p->gap_multipliers);
    for (int c = 0; c < S; c++) largest = fmax(largest, fabs(s->u[c])), sum += s->u[c];
#pragma omp simd reduction(max : largest) reduction(+ : sum)
    for (int64_t i = 0; i < p->K * N; i++) {
        double size = fabs(s->gradient_velocity[i]);
        largest = largest > size ? largest : size;
        sum += size;
    }
    return isfinite(sum) ? largest : INFINITY;
}

/* Tell whether the multipliers prove that no point meets all rows: q'(C x - bound) is violated at the iterate by more
 * than any step inside the bounds can mend, |q'C dx| <= sum of |derivative| times the distance to a bound. Farkas'
 * lemma, with a factor of 2 for rounding. */
static int proves_infeasible(Solver *s) {
    const Program *p = s->p;
    const Limits *l = &s->hard;
    const Equations *e = &s->equations;
    double violated = 0.0;
    double mendable = 0.0;
    for (int64_t j = 0; j < l->count; j++) violated -= l->z[j] * l->distance[j];
    for (int64_t j = 0; j < e->count; j++) violated += e->y[j] * e->residual[j];
    if (!(violated > 0.0)) return 0;
    memset(s->gradient_X, 0, p->K * M * sizeof(double));
    memset(s->u, 0, S * sizeof(double));
    memset(s->q, 0, row_count(p) * sizeof(double)); /* a soft limit makes nothing infeasible, and bounds no step */
    for (int64_t j = 0; j < e->count; j++) s->q[e->row[j]] = e->y[j];
    add_multipliers(*l, 0.0, s->q);
    add_rows_transposed(p, s->q, s->gradient_X, s->u);
    reduced_gradient(p, s->gradient_X, s->u, s->gradient_velocity, s->y);
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) {
            int64_t row = k * M + N + i;
            double distance = p->soft ? UNBOUNDED_STEP : fmax(p->high[row] - p->X[row], p->X[row] - p->low[row]);
            mendable += fmin(distance, UNBOUNDED_STEP) * fabs(s->gradient_velocity[k * N + i]);
        }
    for (int c = 0; c < S; c++) mendable += UNBOUNDED_STEP * fabs(s->u[c]);
    return violated > 2.0 * mendable;
}

static double *allocate(double **work, int64_t count) {
    double *at = *work;
    *work += PADDED(count + WIDTH);
    return at;
}

/* Lay out the arrays of limits in the memory, at most `capacity` of them. */
static void lay_out_limits(Limits *l, int64_t capacity, int soft, double **work) {
    double **arrays[] = {&l->sign, &l->distance, &l->slack, &l->z, &l->ds, &l->dz, &l->inverse_diagonal,
                         &l->e, &l->w, &l->de, &l->relaxation, &l->relaxation_shift};
    l->row = (int64_t *)allocate(work, capacity);
    for (int i = 0; i < (soft ? 12 : 7); i++) *arrays[i] = allocate(work, capacity);
}

/* Lay out all arrays in the memory; returns how many doubles they take. */
static int64_t lay_out(Solver *s, const Program *p, double *work) {
    double *begin = work;
    int64_t rows = row_count(p);
    int64_t K = p->K;
    Equations *e = &s->equations;
    double **of_rows[] = {&s->weight, &s->q, &s->step, &e->residual, &e->y, &e->dy};
    lay_out_limits(&s->hard, 2 * rows, 0, &work);
    lay_out_limits(&s->soft, p->soft ? 2 * K * M : 0, 1, &work);
    for (size_t i = 0; i < sizeof of_rows / sizeof *of_rows; i++) *of_rows[i] = allocate(&work, rows);
    e->row = (int64_t *)allocate(&work, rows);
    s->p = p;
    s->intervals = (IntervalFactors *)allocate(&work, K * (int64_t)(sizeof(IntervalFactors) / sizeof(double)));
    s->positions = (vec *)allocate(&work, K * N * NC);
    s->y = allocate(&work, K * NC);
    s->cost = allocate(&work, K * M);
    s->gradient_X = allocate(&work, K * M);
    s->gradient_velocity = allocate(&work, K * N);
    s->difference = allocate(&work, K * N);
    s->arrow = allocate(&work, K * M * S);
    double **small[] = {&s->cost_tau, &s->u, &s->dtau, &s->schur, &s->durations};
    for (size_t i = 0; i < sizeof small / sizeof *small; i++) *small[i] = allocate(&work, S * S);
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
            l->distance[l->count++] = sign * (s->step[i] - bound);
        }
}

/* List limits and equations of the rows at the first iterate. */
static void list_rows(Solver *s) {
    const Program *p = s->p;
    int64_t count = row_count(p);
    int64_t soft = p->soft ? p->K * M : 0;
    Equations *e = &s->equations;
    list_limits(s, 0, soft, &s->soft);
    list_limits(s, soft, count, &s->hard);
    e->count = 0;
    for (int64_t i = soft; i < count; i++)
        if (is_equation(p, i)) {
            e->row[e->count] = i;
            e->y[e->count] = e->dy[e->count] = 0.0;
            e->residual[e->count++] = s->step[i] - (p->low[i] + p->high[i]) / 2;
        }
}

/* Choose the first slacks and multipliers: all products s z and e w are the barrier, which grows with the largest
 * violation. A slack is at least `bound_push`, and at most a quarter of the way to the other bound. */
static void initialize_limits(Solver *s) {
    const Program *p = s->p;
    double bound_push = p->bound_push;
    double initial_barrier = p->initial_barrier;
    Limits *l = &s->hard;
    for (int64_t j = 0; j < l->count; j++) bound_push = fmax(bound_push, -l->distance[j]);
    for (int64_t j = 0; j < s->equations.count; j++) bound_push = fmax(bound_push, fabs(s->equations.residual[j]));
    initial_barrier *= bound_push / p->bound_push;
    int64_t inputs = p->K * M + 2 * S + p->node_rows;
    int64_t shift = p->K * N;
    for (int64_t j = 0; j < l->count; j++) {
        int64_t low = l->row[j];
        int64_t high = low;
        if (low >= inputs + shift) low -= shift; /* an acceleration has a row for each of its limits */
        else if (low >= inputs) high += shift;
        double width = p->high[high] - p->low[low] + (s->step[low] - s->step[high]);
        l->slack[j] = fmax(l->distance[j], fmin(bound_push, width / 4));
        l->z[j] = initial_barrier / l->slack[j];
        l->ds[j] = l->dz[j] = 0.0;
    }
    l = &s->soft;
    for (int64_t j = 0; j < l->count; j++) {
        double penalty = p->penalty[l->row[j] / M];
        l->e[j] = fmax(p->bound_push - l->distance[j], initial_barrier / penalty);
        l->slack[j] = l->distance[j] + l->e[j];
        l->z[j] = fmin(initial_barrier / l->slack[j], penalty / 2);
        l->w[j] = penalty - l->z[j];
        l->ds[j] = l->dz[j] = l->de[j] = 0.0;
    }
}

static void initialize(Solver *s) {
    const Program *p = s->p;
    double drift[N] = {0};
    s->max_weight = MAX_ROW_WEIGHT;
    s->riccati = (RiccatiData){
        .K = p->K,
        .positions = s->positions,
        .diagonal = s->weight,
        .arrow = p->inputs ? s->arrow : p->arrow,
        .durations = s->durations,
        .difference = s->difference,
        .gap_velocity = p->gap_velocity,
        .gap_tau = p->gap_tau,
        .node_rows = p->node_rows,
        .row_node = p->row_node,
        .row_jacobian = p->row_jacobian,
    };
    memset(s->positions, 0, p->K * N * NC * sizeof(double));
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++)
            for (int j = i; j < N; j++)
                scalars(s->positions + (k * N + i) * NV)[j] = scalars(s->positions + (k * N + j) * NV)[i] =
                    p->positions[(k * N + i) * N + j];
    memset(p->X, 0, p->K * M * sizeof(double));
    memset(p->tau, 0, S * sizeof(double));
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) p->X[k * M + i] = drift[i] -= p->gaps[k * N + i];
    memcpy(s->step, p->X, p->K * M * sizeof(double));
    apply_rows(p, p->tau, s->step);
    list_rows(s);
    initialize_limits(s);
    memset(s->dtau, 0, S * sizeof(double));
    take_step(s, 0.0, 0.0, p->X, p->tau);
}

/* Return the bytes of a Program: callers in another language declare it again and compare. */
int64_t SIZED(psmpc_qp_program_size)(void) {
    return (int64_t)sizeof(Program);
}

int64_t SIZED(psmpc_qp_memory)(const Program *p) {
    Solver s;
    return lay_out(&s, p, NULL);
}

/* Factorize the Hessian with the weights of the rows; smaller largest weights where rounding has made it indefinite. */
static int factorize_regularized(Solver *s) {
    for (; s->max_weight > MIN_ROW_WEIGHT; s->max_weight /= 10.0) {
        form_hessian(s);
        if (riccati_factorize(&s->riccati, s->intervals, s->schur)) return 1;
    }
    return 0;
}

/* Take one step of Mehrotra's predictor-corrector method: an affine step, from its complementarity the centering
 *
 *     sigma = (mu_affine / mu)^3,   mu = (sum of s z and e w) / limits,
 *
 * then the step towards sigma mu, of the fraction to the boundary; primal and dual of one length where `equal_lengths`.
 * Returns 0 where rounding has left no direction. Nocedal, Wright (2006), algorithm 16.4. */
static int predictor_corrector(Solver *s, double limits, int equal_lengths) {
    const Program *p = s->p;
    StepLengths r;
    if (!factorize_regularized(s) || !newton_direction(s, 0.0, 0.0, &r)) return 0;
    double primal = 1.0 / r.primal;
    double dual = 1.0 / r.dual;
    double regularization = FINAL_CENTERING * p->tolerance / limits;
    double mu = s->gap / limits;
    double left = (1.0 - dual) * s->gap + (primal - dual) * r.change + primal * dual * r.product;
    double share = s->gap > 0.0 ? left / s->gap : 0.0;
    if (!newton_direction(s, fmax(share * share * share * mu, regularization), 1.0, &r)) return 0;
    primal = r.primal > 1.0 ? FRACTION_TO_BOUNDARY / r.primal : 1.0;
    dual = r.dual > 1.0 ? FRACTION_TO_BOUNDARY / r.dual : 1.0;
    if (equal_lengths) primal = dual = fmin(primal, dual);
    take_step(s, primal, dual, p->X, p->tau);
    return primal > MIN_STEP_LENGTH || dual > MIN_STEP_LENGTH;
}

int64_t SIZED(psmpc_qp_solve)(const Program *p) {
    Solver s;
    double before = INFINITY;
    int equal_lengths = 0;
    lay_out(&s, p, p->work);
    initialize(&s);
    double limits = fmax((double)(s.hard.count + 2 * s.soft.count), 1.0);
    for (int64_t count = 0;; count++) {
        cost_gradient(&s, p->X, p->tau);
        double gap = s.gap;
        double primal = s.residual;
        double dual = dual_residual(&s);
        double largest = fmax(fmax(primal, dual), gap);
        p->report[0] = (double)count, p->report[1] = primal, p->report[2] = dual, p->report[3] = gap;
        memcpy(p->multipliers, s.q, row_count(p) * sizeof(double));
        if (!isfinite(largest)) return FAILED;
        if (largest <= p->tolerance) return SOLVED;
        if (primal > p->tolerance && proves_infeasible(&s)) return INFEASIBLE;
        /* Two lengths may increase the dual residual; equal lengths decrease every residual. */
        equal_lengths |= primal <= p->acceptable_tolerance && fmax(dual, gap) > before;
        before = fmax(dual, gap);
        if (count == p->max_iterations || !predictor_corrector(&s, limits, equal_lengths))
            return largest <= p->acceptable_tolerance ? SOLVED : FAILED;
    }
}
