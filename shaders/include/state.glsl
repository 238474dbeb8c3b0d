// One value a state: two components for up to two states, four for more; and the image format that holds them.
#if STATES == 1
#define STATE_FORMAT r32f
#elif STATES == 2
#define STATE_FORMAT rg32f
#else
#define STATE_FORMAT rgba32f
#endif

#if STATES <= 2
#define STATE vec2
#define STATE_INT ivec2
#define STATE_BOOL bvec2
#define OF_STATES(v) (v).xy
#define TO_FOUR(s) vec4(s, 0.0, 0.0)
#else
#define STATE vec4
#define STATE_INT ivec4
#define STATE_BOOL bvec4
#define OF_STATES(v) (v)
#define TO_FOUR(s) (s)
#endif
