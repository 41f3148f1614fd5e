#ifndef BARE_METAL_H
#define BARE_METAL_H
#include <stddef.h>

long host_open(const char *name, long mode);
long host_read(long file, void *bytes, unsigned long size);
long host_write(long file, const void *bytes, unsigned long size);
void host_exit(int code);
unsigned long ticks(void);

#endif
