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
