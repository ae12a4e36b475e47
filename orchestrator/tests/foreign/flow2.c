/* A flow unit as others write them: FMI 2.0, scalars, pressures in bar. Three columns of rock, each

       (phi - phi_n) + (p - p_n)/M + dt k p = 0

   with the porosity change phi at the end of the time step given. The signatures are those of FMI 2.0.4. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { COLUMNS = 3 };
static const double BAR = 1e5, LEAKAGE = 1e-9;

typedef struct {
    double pressure[COLUMNS], given[COLUMNS], porosity[COLUMNS], modulus;
    int steps, strict;
} State;

typedef void (*Logger)(void *, const char *, int, const char *, const char *, ...);
typedef struct {
    Logger log;
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Callbacks;

typedef struct {
    State now;
    const Callbacks *callbacks;
    char name[64], label[64];
} Unit;

static int say(Unit *u, int status, const char *text) {
    u->callbacks->log(u->callbacks->environment, u->name, status, "unit", text);
    return status;
}

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const Callbacks *callbacks,
                      int visible, int logging) {
    Unit *u;
    (void)visible, (void)logging;
    if (type != 1 || strcmp(guid, "token") != 0 || strncmp(resources, "file:///", 8) != 0) return NULL;
    u = callbacks->allocate(1, sizeof *u);
    u->callbacks = callbacks;
    u->now.modulus = 1;
    snprintf(u->name, sizeof u->name, "%s", name);
    return u;
}

void fmi2FreeInstance(Unit *u) { u->callbacks->release(u); }
int fmi2SetupExperiment(Unit *u, int d, double t, double start, int s, double stop) {
    (void)u, (void)d, (void)t, (void)s;
    return start < stop ? 0 : 3;
}
int fmi2EnterInitializationMode(Unit *u) { return (void)u, 0; }
int fmi2ExitInitializationMode(Unit *u) { return (void)u, 0; }
int fmi2Terminate(Unit *u) { return (void)u, 0; }

/* 0..: pressures (bar), 10..: porosity changes, 20: modulus (Pa). */
static double *real(Unit *u, unsigned r, double *factor) {
    *factor = r < COLUMNS ? BAR : 1;
    if (r < COLUMNS) return &u->now.pressure[r];
    if (r >= 10 && r < 10 + COLUMNS) return &u->now.given[r - 10];
    return r == 20 ? &u->now.modulus : NULL;
}

int fmi2GetReal(Unit *u, const unsigned *r, size_t n, double *v) {
    for (size_t i = 0; i < n; i++) {
        double factor, *p = real(u, r[i], &factor);
        if (!p) return say(u, 3, "no such variable");
        v[i] = *p / factor;
    }
    return 0;
}

int fmi2SetReal(Unit *u, const unsigned *r, size_t n, const double *v) {
    for (size_t i = 0; i < n; i++) {
        double factor, *p = real(u, r[i], &factor);
        if (!p || r[i] < COLUMNS) return say(u, 3, "no such input");
        *p = v[i] * factor;
    }
    return 0;
}

int fmi2GetInteger(Unit *u, const unsigned *r, size_t n, int *v) { return *v = u->now.steps, r[0] == 0 && n == 1 ? 0 : 3; }
int fmi2SetInteger(Unit *u, const unsigned *r, size_t n, const int *v) { return (void)r, (void)n, (void)v, say(u, 3, "no"); }
int fmi2GetBoolean(Unit *u, const unsigned *r, size_t n, int *v) { return *v = u->now.strict, (void)r, (void)n, 0; }
int fmi2SetBoolean(Unit *u, const unsigned *r, size_t n, const int *v) { return u->now.strict = *v, (void)r, (void)n, 0; }
int fmi2GetString(Unit *u, const unsigned *r, size_t n, const char **v) { return *v = u->label, (void)r, (void)n, 0; }
int fmi2SetString(Unit *u, const unsigned *r, size_t n, const char *const *v) {
    (void)r, (void)n;
    snprintf(u->label, sizeof u->label, "%s", *v);
    return 0;
}

int fmi2DoStep(Unit *u, double t, double dt, int no_return) {
    State *s = &u->now;
    (void)no_return;
    if (s->strict && dt > 0.15) return say(u, 2, "this time step is too long");
    for (int i = 0; i < COLUMNS; i++) {
        double m = s->modulus * (i + 1);
        s->pressure[i] = (s->porosity[i] - s->given[i] + s->pressure[i] / m) / (1 / m + dt * LEAKAGE);
        s->porosity[i] = s->given[i];
    }
    if (++s->steps == 3) {
        u->callbacks->log(u->callbacks->environment, u->name, 1, "unit", "%s took step %d to %.2f s%1000s", u->name, s->steps,
                          t + dt, ".");
        return 1;
    }
    return s->steps == 2 ? say(u, 1, "this is the second time step") : 0;
}

int fmi2GetFMUstate(Unit *u, void **state) {
    if (!*state) *state = malloc(sizeof u->now);
    memcpy(*state, &u->now, sizeof u->now);
    return 0;
}
int fmi2SetFMUstate(Unit *u, void *state) { return memcpy(&u->now, state, sizeof u->now), 0; }
int fmi2FreeFMUstate(Unit *u, void **state) { return (void)u, free(*state), *state = NULL, 0; }
int fmi2SerializedFMUstateSize(Unit *u, void *state, size_t *n) { return (void)state, *n = sizeof u->now, 0; }
int fmi2SerializeFMUstate(Unit *u, void *state, char *bytes, size_t n) { return (void)u, memcpy(bytes, state, n), 0; }
int fmi2DeSerializeFMUstate(Unit *u, const char *bytes, size_t n, void **state) {
    return (void)u, *state = malloc(n), memcpy(*state, bytes, n), 0;
}
int fmi2GetDirectionalDerivative(Unit *u, const unsigned *unknown, size_t n, const unsigned *known, size_t m,
                                 const double *seed, double *result) {
    return (void)unknown, (void)n, (void)known, (void)m, (void)seed, (void)result, say(u, 3, "none");
}
