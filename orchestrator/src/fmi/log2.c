/* The logger of FMI 2.0, whose messages are formats with values: only C can read these. */

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

/* `Environment` of fmi2.rs. */
struct environment {
    void (*keep)(void *messages, int status, const char *message);
    void *messages;
};

void orchestrator_fmi2_log(void *environment, const char *instance, int status, const char *category,
                           const char *message, ...) {
    const struct environment *to = environment;
    char *text = NULL;
    int length;
    va_list values, again;
    (void)instance, (void)category;
    if (!to || !message) return;
    va_start(values, message);
    va_copy(again, values);
    length = vsnprintf(NULL, 0, message, values);
    if (length >= 0) text = malloc((size_t)length + 1);
    if (text) vsnprintf(text, (size_t)length + 1, message, again);
    va_end(again);
    va_end(values);
    /* Better the format than nothing. */
    to->keep(to->messages, status, text ? text : message);
    free(text);
}
