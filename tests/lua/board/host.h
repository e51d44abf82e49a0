/* Files of the computer that runs QEMU, by ARM's semihosting. */
#pragma once

#include <stdint.h>

/* Words of the command line, at most `most`; returns how many. */
int host_arguments(char** words, int most);

/* Reads a whole file; returns its bytes, or ends the program. */
uint32_t host_read(const char* name, void* to, uint32_t most);

void host_write(const char* name, const char* text);

void host_exit(int failed) __attribute__((noreturn));
