// As Android spells it: a failed assertion calls __assert2.
#undef assert
#ifdef NDEBUG
#define assert(condition) ((void)0)
#else
#define assert(condition) ((condition) ? (void)0 : __assert2(__FILE__, __LINE__, __func__, #condition))
#endif
#if !defined(__cplusplus)
_Noreturn void __assert2(const char *, int, const char *, const char *);
#else
extern "C" [[noreturn]] void __assert2(const char *, int, const char *, const char *);
#endif
