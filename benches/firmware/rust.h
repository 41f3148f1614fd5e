/* The Rust module of one unit with imucal-core, linked as a static library. */
int rust_start(void);
void rust_correct(float *rate, float *force);

static int start_correction(void) { return rust_start(); }

__attribute__((noinline)) static void correct(float *rate, float *force) { rust_correct(rate, force); }
