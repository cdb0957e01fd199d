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
