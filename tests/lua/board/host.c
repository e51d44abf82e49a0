#include "host.h"

#include <stddef.h>
#include <string.h>

/* Operations and modes: ARM's "Semihosting for AArch32 and AArch64". */
enum { OPEN = 0x01, CLOSE = 0x02, WRITE = 0x05, READ = 0x06, GET_COMMAND_LINE = 0x15, EXIT = 0x20 };
enum { READ_BINARY = 1, WRITE_BINARY = 5 };
#define APPLICATION_EXIT 0x20026u

static int32_t call(uint32_t operation, const void* arguments) {
  register uint32_t r0 __asm__("r0") = operation;
  register const void* r1 __asm__("r1") = arguments;
  __asm__ volatile("bkpt 0xAB" : "+r"(r0) : "r"(r1) : "memory");
  return (int32_t)r0;
}

void host_exit(int failed) {
  const uint32_t arguments[] = {APPLICATION_EXIT, (uint32_t)failed};
  for (;;) call(EXIT, arguments);
}

static int32_t open_file(const char* name, uint32_t mode) {
  const uint32_t arguments[] = {(uint32_t)name, mode, strlen(name)};
  const int32_t file = call(OPEN, arguments);
  if (file < 0) host_exit(1);
  return file;
}

static void close_file(int32_t file) {
  const uint32_t arguments[] = {(uint32_t)file};
  call(CLOSE, arguments);
}

uint32_t host_read(const char* name, void* to, uint32_t most) {
  const int32_t file = open_file(name, READ_BINARY);
  const uint32_t arguments[] = {(uint32_t)file, (uint32_t)to, most};
  const uint32_t left = (uint32_t)call(READ, arguments);
  close_file(file);
  if (left == 0) host_exit(1); /* too long */
  return most - left;
}

void host_write(const char* name, const char* text) {
  const int32_t file = open_file(name, WRITE_BINARY);
  const uint32_t arguments[] = {(uint32_t)file, (uint32_t)text, strlen(text)};
  if (call(WRITE, arguments) != 0) host_exit(1);
  close_file(file);
}

int host_arguments(char** words, int most) {
  static char line[1024];
  const uint32_t arguments[] = {(uint32_t)line, sizeof line};
  if (call(GET_COMMAND_LINE, arguments) != 0) host_exit(1);
  int count = 0;
  for (char* word = strtok(line, " "); word != NULL && count < most; word = strtok(NULL, " ")) {
    words[count++] = word;
  }
  return count;
}
