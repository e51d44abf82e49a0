"""The flight core: from what is known of the vehicles to what each follower is told. Pure.

A tick of `session.FollowSession`, for one follower. Each step reads only from those before it;
`steps` has what they hand on.

    messages  ->  known     who is where, how old, how sure       known, trust, estimate, look
    known     ->  standing  whether it may be led now, and why    supervisor, engage, joining, guard
    standing  ->  plan      where it is to be, if it were alone   plan, guidance, tow_bar
    plan      ->  allowed   the nearest that leaves room for all  spacing, envelope, half_planes
    allowed   ->  command   what is sent                          session, heights
"""
