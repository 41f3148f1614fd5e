/* Start-up, semihosting and the counter of instructions, for Cortex-M and RV32 under QEMU. */
#include "bare_metal.h"

int main(void);

#if defined(__arm__)
static long semihost(long operation, void *argument)
{
    register long r0 __asm__("r0") = operation;
    register void *r1 __asm__("r1") = argument;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}
#else
static long semihost(long operation, void *argument)
{
    register long a0 __asm__("a0") = operation;
    register void *a1 __asm__("a1") = argument;
    __asm__ volatile(
        ".option push\n.option norvc\n.balign 16\nslli x0, x0, 0x1f\nebreak\nsrai x0, x0, 7\n.option pop"
        : "+r"(a0)
        : "r"(a1)
        : "memory");
    return a0;
}
#endif

long host_open(const char *name, long mode)
{
    long arguments[3] = {(long)name, mode, 0};
    const char *end = name;
    while (*end) ++end;
    arguments[2] = end - name;
    return semihost(1, arguments);
}

/* Number of bytes that were not read. */
long host_read(long file, void *bytes, unsigned long size)
{
    long arguments[3] = {file, (long)bytes, (long)size};
    return semihost(6, arguments);
}

long host_write(long file, const void *bytes, unsigned long size)
{
    long arguments[3] = {file, (long)bytes, (long)size};
    return semihost(5, arguments);
}

void host_exit(int code)
{
    /* The reason ADP_Stopped_ApplicationExit, or ADP_Stopped_RunTimeErrorUnknown. */
    semihost(0x18, (void *)(code == 0 ? 0x20026L : 0x20023L));
    for (;;) {}
}

void *memcpy(void *to, const void *from, size_t size)
{
    unsigned char *t = to;
    const unsigned char *f = from;
    while (size--) *t++ = *f++;
    return to;
}

void *memset(void *to, int value, size_t size)
{
    unsigned char *t = to;
    while (size--) *t++ = (unsigned char)value;
    return to;
}

int memcmp(const void *a, const void *b, size_t size)
{
    const unsigned char *x = a, *y = b;
    for (; size--; ++x, ++y)
        if (*x != *y) return *x - *y;
    return 0;
}

#if defined(__arm__)
void start(void);
extern char stack_end[];

__attribute__((section(".vectors"), used)) static void *const vectors[16] = {
    stack_end, (void *)start,
};

void start(void)
{
#if defined(__ARM_FP)
    /* Full access to the floating-point unit (CPACR). */
    *(volatile unsigned long *)0xE000ED88 |= 0xFu << 20;
    __asm__ volatile("dsb\n isb");
#endif
    /* SysTick from the clock of the processor, without interrupts. */
    *(volatile unsigned long *)0xE000E014 = 0xFFFFFF;
    *(volatile unsigned long *)0xE000E018 = 0;
    *(volatile unsigned long *)0xE000E010 = 5;
    host_exit(main());
}

/* Counts up; of 24 bits. */
unsigned long ticks(void) { return 0xFFFFFF - *(volatile unsigned long *)0xE000E018; }
#else
__asm__(".section .vectors,\"ax\"\n.globl _start\n_start:\n la sp, stack_end\n li t0, 0x6000\n csrs mstatus, t0\n"
        " call start\n");
void start(void) { host_exit(main()); }

unsigned long ticks(void)
{
    unsigned long count;
    __asm__ volatile("csrr %0, minstret" : "=r"(count));
    return count;
}
#endif
