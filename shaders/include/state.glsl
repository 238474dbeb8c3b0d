// One value a state: two components for up to two states, four for more.
#if STATES <= 2
#define STATE vec2
#define STATE_INT ivec2
#define STATE_UINT uvec2
#define STATE_BOOL bvec2
#define OF_STATES(v) (v).xy
#define TO_FOUR(s) vec4(s, 0.0, 0.0)
#else
#define STATE vec4
#define STATE_INT ivec4
#define STATE_UINT uvec4
#define STATE_BOOL bvec4
#define OF_STATES(v) (v)
#define TO_FOUR(s) (s)
#endif
