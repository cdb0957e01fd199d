/* Straight-line functions as tapes: lists of instructions that are carried out for many rows at once.
 *
 * A tape is data, so a new function compiles nothing; the cost of looking at an instruction is shared by the rows of a
 * block and, where several instructions of one kind follow each other, by those. `psmpc_tape_arrange` orders them so.
 *
 * Values stand in slots: those of the arguments, of the constants, then of results of instructions; a slot has one
 * value for each row of a block. Python's numbers of the operations, CasADi's, stand before this. */

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define LANES 8                 /* values of a vector */
#define VECTORS 2               /* vectors of a slot */
#define BLOCK (LANES * VECTORS) /* rows of a block */
typedef double vec __attribute__((vector_size(8 * LANES), may_alias)); /* its entries are read as numbers too */
typedef int64_t mask __attribute__((vector_size(8 * LANES)));

#define INLINE static inline __attribute__((always_inline))

/* One instruction as CasADi has it: it reads registers and writes one. */
typedef struct {
    int32_t operation;
    int32_t result; /* a register; of OP_OUTPUT, the index of the entry among those of all results */
    int32_t left;   /* a register; of OP_INPUT and OP_CONST, the slot */
    int32_t right;  /* a register, that of left again where there is one operand */
} Instruction;

/* `count` instructions of the same operation, one after the other. */
typedef struct {
    int32_t operation;
    int32_t count;
} Run;

/* The slots of an instruction. */
typedef struct {
    int32_t result;
    int32_t left;
    int32_t right;
} Operands;

typedef struct {
    int64_t run_count;
    int64_t argument_count;
    int64_t result_count;
    const Run *runs;
    const Operands *operands;
    const int64_t *argument_sizes;
    const int64_t *result_sizes;
    const int32_t *result_slots;    /* of the entries of all results, one after the other */
    const double *const *arguments; /* arrays (rows, size) */
    double *const *results;         /* arrays (rows, size) */
    vec *slots;                     /* (slots, VECTORS); those of the constants are filled */
} TapeProgram;

INLINE vec choose(mask where, vec yes, vec no) { return (vec)((where & (mask)yes) | (~where & (mask)no)); }

INLINE vec everywhere(double value) {
    vec all;
    for (int lane = 0; lane < LANES; lane++) all[lane] = value;
    return all;
}

INLINE vec truth(mask where) { return choose(where, everywhere(1.0), everywhere(0.0)); }

INLINE vec magnitude(vec a) {
    const mask sign = (mask)everywhere(-0.0);
    return (vec)((mask)a & ~sign);
}

INLINE vec sign(vec a) {
    const vec zero = everywhere(0.0);
    return choose(a < zero, everywhere(-1.0), choose(a > zero, everywhere(1.0), a));
}

/* The next `count` instructions: an expression of vectors a and b, or one of numbers a and b. */
#define EACH_VECTOR(OPERATION, EXPRESSION)                            \
    case OPERATION:                                                   \
        for (; at < end; at++)                                        \
            for (int k = 0; k < vectors; k++) {                       \
                const vec a = slots[at->left * VECTORS + k];          \
                const vec b = slots[at->right * VECTORS + k];         \
                (void)b;                                              \
                slots[at->result * VECTORS + k] = (EXPRESSION);       \
            }                                                         \
        break;
#define EACH_NUMBER(OPERATION, EXPRESSION)                            \
    case OPERATION:                                                   \
        for (; at < end; at++)                                        \
            for (int k = 0; k < vectors * LANES; k++) {               \
                const double a = numbers[at->left * BLOCK + k];       \
                const double b = numbers[at->right * BLOCK + k];      \
                (void)b;                                              \
                numbers[at->result * BLOCK + k] = (EXPRESSION);       \
            }                                                         \
        break;

/* Carry out the instructions for the first vectors of each slot. */
INLINE void carry_out(const TapeProgram *tape, const int vectors) {
    vec *slots = tape->slots;
    double *numbers = (double *)tape->slots;
    const Operands *at = tape->operands;
    for (int64_t r = 0; r < tape->run_count; r++) {
        const Operands *end = at + tape->runs[r].count;
        switch (tape->runs[r].operation) {
            EACH_VECTOR(OP_ADD, a + b)
            EACH_VECTOR(OP_SUB, a - b)
            EACH_VECTOR(OP_MUL, a * b)
            EACH_VECTOR(OP_DIV, a / b)
            EACH_VECTOR(OP_NEG, -a)
            EACH_VECTOR(OP_TWICE, a + a)
            EACH_VECTOR(OP_SQ, a * a)
            EACH_VECTOR(OP_INV, everywhere(1.0) / a)
            EACH_VECTOR(OP_FABS, magnitude(a))
            EACH_VECTOR(OP_FMAX, choose((a < b) | (a != a), b, a))
            EACH_VECTOR(OP_FMIN, choose((a > b) | (a != a), b, a))
            EACH_VECTOR(OP_LT, truth(a < b))
            EACH_VECTOR(OP_LE, truth(a <= b))
            EACH_VECTOR(OP_EQ, truth(a == b))
            EACH_VECTOR(OP_NE, truth(a != b))
            EACH_VECTOR(OP_NOT, truth(a == everywhere(0.0)))
            EACH_VECTOR(OP_AND, truth((a != everywhere(0.0)) & (b != everywhere(0.0))))
            EACH_VECTOR(OP_OR, truth((a != everywhere(0.0)) | (b != everywhere(0.0))))
            EACH_VECTOR(OP_IF_ELSE_ZERO, choose(a != everywhere(0.0), b, everywhere(0.0)))
            EACH_VECTOR(OP_SIGN, sign(a))
            EACH_NUMBER(OP_SQRT, sqrt(a))
            EACH_NUMBER(OP_SIN, sin(a))
            EACH_NUMBER(OP_COS, cos(a))
            EACH_NUMBER(OP_TAN, tan(a))
            EACH_NUMBER(OP_ASIN, asin(a))
            EACH_NUMBER(OP_ACOS, acos(a))
            EACH_NUMBER(OP_ATAN, atan(a))
            EACH_NUMBER(OP_ATAN2, atan2(a, b))
            EACH_NUMBER(OP_SINH, sinh(a))
            EACH_NUMBER(OP_COSH, cosh(a))
            EACH_NUMBER(OP_TANH, tanh(a))
            EACH_NUMBER(OP_ASINH, asinh(a))
            EACH_NUMBER(OP_ACOSH, acosh(a))
            EACH_NUMBER(OP_ATANH, atanh(a))
            EACH_NUMBER(OP_EXP, exp(a))
            EACH_NUMBER(OP_EXPM1, expm1(a))
            EACH_NUMBER(OP_LOG, log(a))
            EACH_NUMBER(OP_LOG1P, log1p(a))
            EACH_NUMBER(OP_POW, pow(a, b))
            EACH_NUMBER(OP_CONSTPOW, pow(a, b))
            EACH_NUMBER(OP_HYPOT, hypot(a, b))
            EACH_NUMBER(OP_ERF, erf(a))
            EACH_NUMBER(OP_FLOOR, floor(a))
            EACH_NUMBER(OP_CEIL, ceil(a))
            EACH_NUMBER(OP_FMOD, fmod(a, b))
            EACH_NUMBER(OP_COPYSIGN, copysign(a, b))
        }
    }
}

/* Separate functions, so that each is compiled for its number of vectors. */
static __attribute__((noinline)) void carry_out_half(const TapeProgram *tape) { carry_out(tape, 1); }
static __attribute__((noinline)) void carry_out_whole(const TapeProgram *tape) { carry_out(tape, VECTORS); }

/* Evaluate a tape at rows of its arguments. */
void psmpc_tape_run(const TapeProgram *tape, int64_t rows) {
    double *numbers = (double *)tape->slots;
    for (int64_t first = 0; first < rows; first += BLOCK) {
        const int64_t here = rows - first < BLOCK ? rows - first : BLOCK;
        double *slot = numbers;
        for (int64_t i = 0; i < tape->argument_count; i++) {
            const int64_t size = tape->argument_sizes[i];
            const double *argument = tape->arguments[i] + first * size;
            for (int64_t j = 0; j < size; j++, slot += BLOCK)
                for (int row = 0; row < BLOCK; row++) /* rows after the last repeat it: they fill the vectors */
                    slot[row] = argument[(row < here ? row : here - 1) * size + j];
        }
        if (here <= LANES)
            carry_out_half(tape);
        else
            carry_out_whole(tape);
        const int32_t *from = tape->result_slots;
        for (int64_t i = 0; i < tape->result_count; i++) {
            const int64_t size = tape->result_sizes[i];
            double *result = tape->results[i] + first * size;
            for (int64_t row = 0; row < here; row++)
                for (int64_t j = 0; j < size; j++)
                    result[row * size + j] = numbers[from[j] * (int64_t)BLOCK + row];
            from += size;
        }
    }
}

#define OPERATIONS 256 /* more than CasADi has */
#define WINDOW 5000    /* instructions that are ordered together; in longer windows values live longer */

/* An instruction on values: those below `given` are arguments and constants, given + i is the result of the i-th. */
typedef struct {
    int32_t operation;
    int32_t left;
    int32_t right;
} Statement;

/* What a tape is made of, and what is noted of each statement or value on the way. */
typedef struct {
    int32_t given;
    int32_t count;         /* statements */
    Statement *statements; /* (count,) */
    int32_t *order;        /* statements in the order of the tape, (count,) */
    int32_t *waits;        /* for how many others of its window a statement waits, (count,) */
    int32_t *users;        /* the last that reads its result, 2 * statement + side, or -1, (count,) */
    int32_t *next_user;    /* the one before that, (2 count,) */
    int32_t *next;         /* the next that is ready and has the same operation, or -1, (count,) */
    int32_t *spare;        /* slots that are free, (2 count,) */
    int32_t *last_use;     /* place of the last statement that reads a value, (given + count,) */
    int32_t *slot;         /* of each value, (given + count,) */
} Arrangement;

/* Statements of a window that wait for nothing, by operation: lists, first come, first served. */
typedef struct {
    int32_t first[OPERATIONS];
    int32_t last[OPERATIONS];
    int32_t count[OPERATIONS];
} Ready;

static void make_ready(Ready *ready, const Arrangement *all, int32_t i) {
    const int32_t operation = all->statements[i].operation;
    all->next[i] = -1;
    if (ready->count[operation]++)
        all->next[ready->last[operation]] = i;
    else
        ready->first[operation] = i;
    ready->last[operation] = i;
}

static int32_t take(Ready *ready, const Arrangement *all, int32_t operation) {
    const int32_t taken = ready->first[operation];
    ready->first[operation] = all->next[taken];
    ready->count[operation]--;
    return taken;
}

/* Turn instructions into statements; the entries of `result_values` get the values that are results. */
static void read_statements(const Instruction *instructions, int64_t count, int32_t *in_register, Arrangement *all,
                            int32_t *result_values) {
    for (int64_t i = 0; i < count; i++) {
        const Instruction *each = &instructions[i];
        if (each->operation == OP_INPUT || each->operation == OP_CONST)
            in_register[each->result] = each->left;
        else if (each->operation == OP_ASSIGN)
            in_register[each->result] = in_register[each->left];
        else if (each->operation == OP_OUTPUT)
            result_values[each->result] = in_register[each->left];
        else {
            all->statements[all->count] =
                (Statement){each->operation, in_register[each->left], in_register[each->right]};
            in_register[each->result] = all->given + all->count++;
        }
    }
}

/* Order the statements [begin, end) so that those of one operation follow each other: always the operation of which
 * most are ready, until none is left. */
static void order_window(const Arrangement *all, int32_t begin, int32_t end) {
    Ready ready;
    memset(&ready, 0, sizeof ready);
    for (int32_t i = begin; i < end; i++) {
        const int32_t read[2] = {all->statements[i].left - all->given, all->statements[i].right - all->given};
        all->users[i] = -1;
        all->waits[i] = 0;
        for (int side = 0; side < 2; side++)
            if (read[side] >= begin && !(side && read[1] == read[0])) {
                all->next_user[2 * i + side] = all->users[read[side]];
                all->users[read[side]] = 2 * i + side;
                all->waits[i]++;
            }
        if (!all->waits[i]) make_ready(&ready, all, i);
    }
    for (int32_t place = begin; place < end;) {
        int32_t most = 0;
        for (int32_t j = 1; j < OPERATIONS; j++)
            if (ready.count[j] > ready.count[most]) most = j;
        while (ready.count[most]) {
            const int32_t taken = take(&ready, all, most);
            all->order[place++] = taken;
            for (int32_t user = all->users[taken]; user >= 0; user = all->next_user[user])
                if (!--all->waits[user / 2]) make_ready(&ready, all, user / 2);
        }
    }
}

/* Note until when each value is needed; results and what is given, to the end. */
static void find_last_uses(const Arrangement *all, const int32_t *result_values, int64_t results) {
    for (int32_t value = 0; value < all->given + all->count; value++)
        all->last_use[value] = value < all->given ? all->count : -1;
    for (int32_t place = 0; place < all->count; place++) {
        const Statement *each = &all->statements[all->order[place]];
        if (each->left >= all->given) all->last_use[each->left] = place;
        if (each->right >= all->given) all->last_use[each->right] = place;
    }
    for (int64_t i = 0; i < results; i++) all->last_use[result_values[i]] = all->count;
}

/* Give every value a slot, which is free again after the last statement that reads it; return how many slots there are,
 * and write the operands of the tape. */
static int32_t assign_slots(const Arrangement *all, Operands *operands) {
    int32_t top = all->given;
    int32_t spares = 0;
    for (int32_t value = 0; value < all->given; value++) all->slot[value] = value;
    for (int32_t place = 0; place < all->count; place++) {
        const int32_t i = all->order[place];
        const int32_t a = all->statements[i].left;
        const int32_t b = all->statements[i].right;
        const int32_t result = all->given + i;
        if (all->last_use[a] == place) all->spare[spares++] = all->slot[a];
        if (b != a && all->last_use[b] == place) all->spare[spares++] = all->slot[b];
        all->slot[result] = spares ? all->spare[--spares] : top++;
        if (all->last_use[result] < 0) all->spare[spares++] = all->slot[result];
        operands[place] = (Operands){all->slot[result], all->slot[a], all->slot[b]};
    }
    return top;
}

/* Write the runs of a tape; return how many there are. */
static int64_t find_runs(const Arrangement *all, Run *runs) {
    int64_t count = 0;
    for (int32_t place = 0; place < all->count; place++) {
        const int32_t operation = all->statements[all->order[place]].operation;
        if (count && runs[count - 1].operation == operation)
            runs[count - 1].count++;
        else
            runs[count++] = (Run){operation, 1};
    }
    return count;
}

/* Make a tape of instructions.
 *
 * Arguments: `given`, the number of slots of arguments and constants; `registers`, of what the instructions use;
 * `results`, the number of entries of all results. Written: `runs` and `operands`, with room for `count` of each,
 * `result_slots`, and the numbers of runs and of slots. Returns 0, or -1 where there is no memory. */
int64_t psmpc_tape_arrange(const Instruction *instructions, int64_t count, int64_t given, int64_t registers,
                           int64_t results, Run *runs, Operands *operands, int32_t *result_slots, int64_t *run_count,
                           int64_t *slot_count) {
    const int64_t values = given + count;
    Arrangement all = {.given = (int32_t)given};
    all.statements = malloc((size_t)(count + 1) * sizeof *all.statements);
    all.order = malloc((size_t)(8 * count + 2 * values + registers + 1) * sizeof *all.order);
    if (!all.statements || !all.order) {
        free(all.statements);
        free(all.order);
        return -1;
    }
    all.waits = all.order + count;
    all.users = all.waits + count;
    all.next_user = all.users + count;
    all.next = all.next_user + 2 * count;
    all.spare = all.next + count;
    all.last_use = all.spare + 2 * count;
    all.slot = all.last_use + values;
    int32_t *in_register = all.slot + values;
    read_statements(instructions, count, in_register, &all, result_slots);
    for (int32_t begin = 0; begin < all.count; begin += WINDOW)
        order_window(&all, begin, begin + WINDOW < all.count ? begin + WINDOW : all.count);
    find_last_uses(&all, result_slots, results);
    *slot_count = assign_slots(&all, operands);
    *run_count = find_runs(&all, runs);
    for (int64_t i = 0; i < results; i++) result_slots[i] = all.slot[result_slots[i]];
    free(all.statements);
    free(all.order);
    return 0;
}
