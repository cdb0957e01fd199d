/* The steps of the interior-point method: weights of the rows, Newton direction, its length.
 *
 * Each row's multiplier is proximal: half the square of its change is charged with 1 / stiffness, which bounds the
 * weight a row gets, and vanishes at the solution.
 */

/* Set the Hessian with the rows' weights. */
static void weigh(Solver *s) {
    const Program *p = s->p;
    Rows *r = &s->rows;
    for (int64_t i = 0; i < r->count; i++) {
        r->il[i] = 1.0 / (r->sl[i] + r->zl[i] / s->stiffness);
        r->iu[i] = 1.0 / (r->su[i] + r->zu[i] / s->stiffness);
        r->weight[i] = r->zl[i] * r->il[i] + r->zu[i] * r->iu[i] + r->equal[i] * s->stiffness;
    }
    weigh_soft(r, s->stiffness);
    const double *w = s->rows.weight + p->K * M;
    memcpy(s->durations, p->durations, S * S * sizeof(double));
    for (int c = 0; c < S; c++) {
        s->durations[c * S + c] += w[c];
        for (int e = 0; e < S; e++) s->durations[c * S + e] += w[S];
    }
    s->stages.diagonal = s->rows.weight;
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

/* Newton direction with complementarities towards `target` less the products of the affine step, if `corrected`. */
static int direction(Solver *s, const double *tau, double target, double corrected) {
    const Program *p = s->p;
    Rows *r = &s->rows;
    double residual[2 * S + 1];
    give_way(r, target, corrected);
    for (int64_t i = 0; i < r->count; i++) {
        double cl = r->below[i] * (target - corrected * r->dsl[i] * r->dzl[i]);
        double cu = r->above[i] * (target - corrected * r->dsu[i] * r->dzu[i]);
        double l = (cl - r->zl[i] * (r->v[i] - r->from[i])) * r->il[i];
        double u = (cu - r->zu[i] * (r->to[i] - r->v[i])) * r->iu[i];
        r->q[i] = r->zu[i] + u - r->zl[i] - l + r->equal[i] * (r->y[i] + (r->v[i] - r->low[i]) * s->stiffness);
    }
    memcpy(s->lin, s->cost, p->K * M * sizeof(double));
    memcpy(s->u, s->cost_tau, S * sizeof(double));
    add_rows(p, r->q, s->lin, s->u);
    add_given(p, s->nu, s->u);
    for (int e = 0; e < (int)p->given; e++) residual[e] = given_left(p, tau, e);
    backward(&s->stages, s->intervals, s->lin, s->u, s->y);
    if (!solve_durations(p, s->U, s->u, residual, s->stiffness, s->dtau, s->dnu)) return 0;
    forward(&s->stages, s->intervals, s->dtau, s->y, s->dX);
    rows_of(p, s->dX, s->dtau, r->dv);
    for (int64_t i = 0; i < r->count; i++) {
        double cl = r->below[i] * (target - corrected * r->dsl[i] * r->dzl[i]);
        double cu = r->above[i] * (target - corrected * r->dsu[i] * r->dzu[i]);
        double above_low = r->v[i] - r->from[i] + r->dv[i], below_high = r->to[i] - r->v[i] - r->dv[i];
        r->dzl[i] = (cl - r->zl[i] * above_low) * r->il[i];
        r->dzu[i] = (cu - r->zu[i] * below_high) * r->iu[i];
        r->dsl[i] = r->below[i] * (above_low - r->sl[i]) + r->dzl[i] / s->stiffness;
        r->dsu[i] = r->above[i] * (below_high - r->su[i]) + r->dzu[i] / s->stiffness;
        r->dy[i] = r->equal[i] * above_low * s->stiffness;
    }
    direct_soft(r);
    return 1;
}

/* Longest shares of the step that keep slacks and multipliers positive. */
static void longest(const Rows *r, double *primal, double *dual) {
    double s = 0.0, z = 0.0;
#pragma omp simd reduction(max : s, z)
    for (int64_t i = 0; i < r->count; i++) {
        double a = -r->dsl[i] / r->sl[i], b = -r->dsu[i] / r->su[i];
        double c = -r->dzl[i] / (r->zl[i] + 1.0 - r->below[i]), d = -r->dzu[i] / (r->zu[i] + 1.0 - r->above[i]);
        a = a > b ? a : b;
        c = c > d ? c : d;
        s = s > a ? s : a;
        z = z > c ? z : c;
    }
    shrink_soft(r, &s, &z);
    *primal = 1.0 / (s > 1.0 ? s : 1.0);
    *dual = 1.0 / (z > 1.0 ? z : 1.0);
}

static double complementarity(const Rows *r, double primal, double dual) {
    double sum = 0.0;
#pragma omp simd reduction(+ : sum)
    for (int64_t i = 0; i < r->count; i++)
        sum += (r->sl[i] + primal * r->dsl[i]) * (r->zl[i] + dual * r->dzl[i]) +
               (r->su[i] + primal * r->dsu[i]) * (r->zu[i] + dual * r->dzu[i]);
    return sum + soft_complementarity(r, primal, dual);
}

static void move(Solver *s, double primal, double dual, double *X, double *tau) {
    Rows *r = &s->rows;
    move_soft(r, primal, dual);
    for (int64_t i = 0; i < s->p->K * M; i++) X[i] += primal * s->dX[i];
    for (int c = 0; c < S; c++) tau[c] += primal * s->dtau[c];
    for (int e = 0; e < (int)s->p->given; e++) s->nu[e] += dual * s->dnu[e];
    for (int64_t i = 0; i < r->count; i++) {
        r->sl[i] += primal * r->dsl[i];
        r->su[i] += primal * r->dsu[i];
        r->zl[i] += dual * r->dzl[i];
        r->zu[i] += dual * r->dzu[i];
        r->y[i] += dual * r->dy[i];
    }
    rows_of(s->p, X, tau, r->v);
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
    const Rows *r = &s->rows;
    const Program *p = s->p;
    double worst = soft_residual(r);
#pragma omp simd reduction(max : worst)
    for (int64_t i = r->soft; i < r->count; i++) {
        double l = r->below[i] * fabs(r->v[i] - r->low[i] - r->sl[i]);
        double u = r->above[i] * fabs(r->high[i] - r->v[i] - r->su[i]);
        double e = r->equal[i] * fabs(r->v[i] - r->low[i]);
        l = l > u ? l : u;
        l = l > e ? l : e;
        worst = worst > l ? worst : l;
    }
    for (int e = 0; e < (int)p->given; e++) worst = fmax(worst, fabs(given_left(p, tau, e)));
    return worst;
}

/* Largest derivative of the Lagrangian by a velocity or a duration, infinite where one is no number; leaves the
 * multipliers of the gaps. */
static double dual_residual(Solver *s) {
    const Program *p = s->p;
    Rows *r = &s->rows;
    double worst = 0.0, sum = 0.0;
    for (int64_t i = 0; i < r->count; i++) r->q[i] = r->zu[i] - r->zl[i] + r->y[i];
    memcpy(s->lin, s->cost, p->K * M * sizeof(double));
    memcpy(s->u, s->cost_tau, S * sizeof(double));
    add_rows(p, r->q, s->lin, s->u);
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
    const Rows *r = &s->rows;
    double violated = 0.0, mendable = 0.0;
    for (int64_t i = r->soft; i < r->count; i++)
        violated += r->zl[i] * r->below[i] * (r->low[i] - r->v[i]) + r->zu[i] * r->above[i] * (r->v[i] - r->high[i]) +
                    r->y[i] * r->equal[i] * (r->v[i] - r->low[i]);
    for (int e = 0; e < (int)p->given; e++) violated -= s->nu[e] * given_left(p, tau, e);
    if (!(violated > 0.0)) return 0;
    memset(s->lin, 0, p->K * M * sizeof(double));
    memset(s->u, 0, S * sizeof(double));
    memset(r->q, 0, r->soft * sizeof(double)); /* a soft row makes nothing infeasible, and bounds no step */
    add_rows(p, r->q, s->lin, s->u);
    reduce(p, s->lin, s->u, s->adjoint, s->y);
    for (int64_t k = 0; k < p->K; k++)
        for (int i = 0; i < N; i++) {
            int64_t row = k * M + N + i;
            double room = LONGEST;
            if (r->equal[row] != 0.0) room = fabs(r->low[row] - r->v[row]);
            else if (row >= r->soft && r->below[row] * r->above[row] != 0.0)
                room = fmax(fabs(r->high[row] - r->v[row]), fabs(r->v[row] - r->low[row]));
            mendable += room * fabs(s->adjoint[k * N + i]);
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
    int64_t count = row_count(p), K = p->K;
    Rows *r = &s->rows;
    double **arrays[] = {&r->low, &r->high, &r->below, &r->above, &r->equal, &r->v,   &r->dv,
                         &r->weight, &r->q, &r->sl, &r->su, &r->zl, &r->zu, &r->dsl,
                         &r->dsu, &r->dzl, &r->dzu, &r->il, &r->iu, &r->y, &r->dy, &r->from, &r->to};
    double **soft[] = {&r->el, &r->eu, &r->wl, &r->wu, &r->del, &r->deu, &r->gl, &r->gu};
    for (size_t i = 0; i < sizeof arrays / sizeof *arrays; i++) *arrays[i] = take(&work, count);
    r->count = count;
    r->soft = p->soft ? K * M : 0;
    for (size_t i = 0; i < sizeof soft / sizeof *soft; i++) *soft[i] = take(&work, r->soft);
    s->p = p;
    s->intervals = (Interval *)take(&work, K * (int64_t)(sizeof(Interval) / sizeof(double)));
    s->positions = (vec *)take(&work, K * N * NC);
    s->y = take(&work, K * NC);
    s->cost = take(&work, K * M);
    s->lin = take(&work, K * M);
    s->dX = take(&work, K * M);
    s->adjoint = take(&work, K * N);
    s->difference = take(&work, K * N);
    s->arrow = take(&work, K * M * S);
    double **small[] = {&s->cost_tau, &s->u, &s->dtau, &s->nu, &s->dnu, &s->U, &s->durations};
    for (size_t i = 0; i < sizeof small / sizeof *small; i++) *small[i] = take(&work, (S + 1) * (S + 1) + 2 * S);
    return work - begin;
}

static void begin(Solver *s) {
    const Program *p = s->p;
    Rows *r = &s->rows;
    double shift[N] = {0};
    s->stiffness = STIFFEST;
    s->stages = (Stages){.K = p->K, .positions = s->positions, .arrow = p->inputs ? s->arrow : p->arrow,
                         .durations = s->durations, .difference = s->difference, .gap_velocity = p->gap_velocity,
                         .gap_tau = p->gap_tau, .ends = p->ends, .end_node = p->end_node, .end_rows = p->end_rows};
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
    rows_of(p, p->X, p->tau, r->v);
    double push = p->push, barrier = p->barrier;
    for (int64_t i = r->soft; i < r->count; i++)
        push = fmax(push, fmax(p->low[i] - r->v[i], r->v[i] - p->high[i]));
    barrier *= push / p->push;
    for (int64_t i = 0; i < r->count; i++) {
        double low = p->low[i], high = p->high[i], width = high - low;
        r->equal[i] = i >= r->soft && width <= NARROW;
        r->below[i] = low > -INFINITY && r->equal[i] == 0.0;
        r->above[i] = high < INFINITY && r->equal[i] == 0.0;
        r->low[i] = r->equal[i] != 0.0 ? (low + high) / 2 : r->below[i] != 0.0 ? low : 0.0;
        r->high[i] = r->above[i] != 0.0 ? high : 0.0;
        r->from[i] = r->low[i];
        r->to[i] = r->high[i];
        double slack = fmin(push, width / 4);
        r->sl[i] = r->below[i] != 0.0 ? fmax(r->v[i] - low, slack) : 1.0;
        r->su[i] = r->above[i] != 0.0 ? fmax(high - r->v[i], slack) : 1.0;
        r->zl[i] = r->below[i] * barrier / r->sl[i];
        r->zu[i] = r->above[i] * barrier / r->su[i];
        r->y[i] = r->dsl[i] = r->dsu[i] = r->dzl[i] = r->dzu[i] = r->dy[i] = 0.0;
    }
    begin_soft(r, p->penalty, p->push, barrier);
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
    longest(&s->rows, &primal, &dual);
    double share = gap > 0.0 ? complementarity(&s->rows, primal, dual) / gap : 0.0;
    if (!direction(s, p->tau, fmax(share * share * share * mu, CENTER * p->tolerance / limits), 1.0)) return 0;
    longest(&s->rows, &primal, &dual);
    primal = primal < 1.0 ? TO_BOUNDARY * primal : 1.0;
    dual = dual < 1.0 ? TO_BOUNDARY * dual : 1.0;
    if (alike) primal = dual = fmin(primal, dual);
    move(s, primal, dual, p->X, p->tau);
    return primal > SHORTEST || dual > SHORTEST;
}

int64_t psmpc_qp_solve(const Program *p) {
    Solver s;
    Rows *r = &s.rows;
    double limits = 0.0, before = INFINITY;
    int alike = 0;
    lay_out(&s, p, p->work);
    begin(&s);
    for (int64_t i = 0; i < r->count; i++) limits += (r->below[i] + r->above[i]) * (i < r->soft ? 2.0 : 1.0);
    for (int64_t count = 0;; count++) {
        cost_gradient(&s, p->X, p->tau);
        double gap = complementarity(r, 0.0, 0.0), primal = primal_residual(&s, p->tau), dual = dual_residual(&s);
        double worst = fmax(fmax(primal, dual), gap);
        p->report[0] = (double)count, p->report[1] = primal, p->report[2] = dual, p->report[3] = gap;
        memcpy(p->multipliers, r->q, r->count * sizeof(double));
        memcpy(p->given_multipliers, s.nu, p->given * sizeof(double));
        if (!isfinite(worst)) return FAILED;
        if (worst <= p->tolerance) return SOLVED;
        if (primal > p->tolerance && proves_infeasible(&s, p->tau)) return INFEASIBLE;
        /* Steps of two lengths may throw the gradient about; steps of one length lessen every residual. */
        alike |= primal <= p->nearly && fmax(dual, gap) > before;
        before = fmax(dual, gap);
        if (count == p->limit || !iterate(&s, fmax(limits, 1.0), gap, alike))
            return worst <= p->nearly ? SOLVED : FAILED;
    }
}
