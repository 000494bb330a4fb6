// What the NDK links in front of every library: its handle, its destructors, and which Android it is for.
extern void __cxa_finalize(void *);
__attribute__((visibility("hidden"))) void *__dso_handle = &__dso_handle;
__attribute__((destructor)) static void finalize(void) { __cxa_finalize(&__dso_handle); }
__attribute__((section(".note.android.ident"), used, aligned(4))) static const struct {
  int name_bytes, bytes, type;
  char name[8];
  int api;
} ident = {8, 4, 1, "Android", 24};
