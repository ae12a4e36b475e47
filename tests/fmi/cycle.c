/* Loads the library of a co-simulation unit and goes once through load, step, rollback, serialise, free: for memory
 * checkers. Arguments: library, instantiation token, folder of the resources (ending with a slash), step size (s). */

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi3FunctionTypes.h"

static void told(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message) {
    (void)environment;
    fprintf(stderr, "%d %s: %s\n", status, category, message);
}

static void *library;

static void *named(const char *name) {
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "%s\n", dlerror());
        exit(1);
    }
    return found;
}

#define F(name) ((fmi3##name##TYPE *)named("fmi3" #name))
#define MUST(call)                                  \
    if ((call) != fmi3OK) {                         \
        fprintf(stderr, "failed: %s\n", #call);     \
        return 1;                                   \
    }

int main(int count, char **arguments) {
    if (count != 5 || !(library = dlopen(arguments[1], RTLD_NOW | RTLD_LOCAL))) {
        fprintf(stderr, "%s\n", count == 5 ? dlerror() : "four arguments are needed");
        return 1;
    }
    double step = atof(arguments[4]), last;
    fmi3Boolean event, stop, early;
    fmi3Instance unit = F(InstantiateCoSimulation)("unit", arguments[2], arguments[3], fmi3False, fmi3False, fmi3False,
                                                   fmi3False, NULL, 0, NULL, told, NULL);
    if (!unit) return 1;
    MUST(F(EnterInitializationMode)(unit, fmi3False, 0, 0, fmi3False, 0));
    MUST(F(ExitInitializationMode)(unit));
    fmi3FMUState state = NULL, again = NULL;
    MUST(F(GetFMUState)(unit, &state));
    for (int k = 0; k < 2; k++) {
        MUST(F(SetFMUState)(unit, state));
        MUST(F(DoStep)(unit, 0, step, fmi3False, &event, &stop, &early, &last));
    }
    size_t size;
    MUST(F(SerializedFMUStateSize)(unit, state, &size));
    fmi3Byte *bytes = malloc(size);
    MUST(F(SerializeFMUState)(unit, state, bytes, size));
    MUST(F(DeserializeFMUState)(unit, bytes, size, &again));
    free(bytes);
    MUST(F(SetFMUState)(unit, again));
    MUST(F(DoStep)(unit, 0, step, fmi3False, &event, &stop, &early, &last));
    MUST(F(FreeFMUState)(unit, &state));
    MUST(F(FreeFMUState)(unit, &again));
    fmi3ValueReference unknown = 7777;
    double value;
    if (F(GetFloat64)(unit, &unknown, 1, &value, 1) != fmi3Error) return 1;
    F(FreeInstance)(unit);
    puts("done");
    return 0;
}
