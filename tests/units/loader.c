/* The library of a Python unit for hosts without Python.
 *
 * pythonfmu3's own library leaves Python's functions to its host, and so do NumPy and other packages. This one is linked
 * with Python's library and with pythonfmu3's, whose FMI functions the host finds through it, and offers Python's to all.
 */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <signal.h>
#include <stdlib.h>
#include "fmi3FunctionTypes.h"

__attribute__((constructor)) static void begin(void) {
    dlopen(PYTHON_LIBRARY, RTLD_LAZY | RTLD_NOLOAD | RTLD_GLOBAL);
    setenv("PYTHONPATH", PYTHON_PACKAGES, 0);
}

/* Called in the place of pythonfmu3's at exit, which would end a Python that its static destructors have ended. */
void finalizePythonInterpreter(void) {}

/* The first instance starts Python, which would take the host's Ctrl-C. */
fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t count,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    fmi3InstantiateCoSimulationTYPE *make = dlsym(RTLD_NEXT, "fmi3InstantiateCoSimulation");
    struct sigaction before;
    sigaction(SIGINT, NULL, &before);
    fmi3Instance instance = make(
        name, token, resources, visible, logging, events, early, required, count, environment, log, update);
    sigaction(SIGINT, &before, NULL);
    return instance;
}
