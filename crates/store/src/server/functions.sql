-- Functions that statements and views of the store use and PostgreSQL has otherwise or not at all. They stand in the
-- schema of the program, which is looked through before the server's own.

-- Wall time, microseconds since 1970.
CREATE FUNCTION clock_us() RETURNS bigint LANGUAGE sql VOLATILE PARALLEL SAFE
AS $$ SELECT CAST(extract(epoch FROM clock_timestamp()) * 1000000 AS bigint) $$;

-- Wall time, seconds since 1970, whatever parts of a second are asked for.
CREATE FUNCTION unixepoch(parts text) RETURNS double precision LANGUAGE sql VOLATILE PARALLEL SAFE
AS $$ SELECT CAST(extract(epoch FROM clock_timestamp()) AS double precision) $$;

-- Microseconds since 1970 as views show them: 2026-01-05T06:00:00.000Z. Rounded to the millisecond as SQLite rounds,
-- which counts days from the noon of 4714 BC in floating point.
CREATE FUNCTION time_text(microseconds bigint) RETURNS text LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$
    SELECT to_char(
        timestamp '1970-01-01'
        + (trunc(CAST(microseconds AS double precision) / 1000000.0 * 1000.0 + 210866760000000.0 + 0.5)
           - 210866760000000.0) * interval '1 millisecond',
        'YYYY-MM-DD"T"HH24:MI:SS.MS"Z"')
$$;

-- Whether a text is JSON; one that is not is an error that says where.
CREATE FUNCTION json_valid(content text) RETURNS boolean LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT CAST(content AS json) IS NOT NULL $$;

-- Elements of a JSON array, numbers and texts alike as texts.
CREATE FUNCTION json_each(content text) RETURNS TABLE (value text) LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT value FROM json_array_elements_text(CAST(content AS json)) $$;

-- The first that is not NULL. Written as the index on fits of warm-up has it.
CREATE FUNCTION ifnull(value bigint, otherwise bigint) RETURNS bigint LANGUAGE sql IMMUTABLE PARALLEL SAFE
AS $$ SELECT coalesce(value, otherwise) $$;

-- The larger of some numbers; NULL if one of them is.
CREATE FUNCTION max(a bigint, b bigint) RETURNS bigint LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT greatest(a, b) $$;
CREATE FUNCTION max(a bigint, b bigint, c bigint) RETURNS bigint LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT greatest(a, b, c) $$;
CREATE FUNCTION max(a double precision, b double precision) RETURNS double precision
LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT greatest(a, b) $$;

-- Where a text begins in another one, from 1; 0 if it is not there.
CREATE FUNCTION instr(content text, part text) RETURNS integer LANGUAGE sql IMMUTABLE STRICT PARALLEL SAFE
AS $$ SELECT strpos(content, part) $$;

-- Random bytes.
CREATE FUNCTION randomblob(bytes integer) RETURNS bytea LANGUAGE sql VOLATILE PARALLEL SAFE
AS $$
    SELECT substring(decode(string_agg(replace(CAST(gen_random_uuid() AS text), '-', ''), ''), 'hex') FOR bytes)
    FROM generate_series(1, (bytes + 15) / 16)
$$;

-- Whether a column of a view equals a value that was given as a text, and as a number where it is one.
CREATE FUNCTION equals(content text, text_value text, number double precision) RETURNS boolean
LANGUAGE sql IMMUTABLE PARALLEL SAFE
AS $$ SELECT content = text_value $$;
CREATE FUNCTION equals(content double precision, text_value text, number double precision) RETURNS boolean
LANGUAGE sql IMMUTABLE PARALLEL SAFE
AS $$ SELECT content = number $$;
