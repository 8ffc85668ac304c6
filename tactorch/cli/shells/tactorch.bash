# Completion of tactorch in bash. For good, in ~/.bashrc:
#   eval "$(tactorch completion bash)"
_tactorch() {
    local line=${COMP_LINE:0:COMP_POINT} word about quoted
    local current=${line##*[[:space:]]} begun=""
    # Bash replaces what stands after the last of its word breaks.
    [[ $COMP_WORDBREAKS == *=* && $current == *=* ]] && begun=${current%"${current##*=}"}
    COMPREPLY=()
    while IFS=$'\t' read -r word about; do
        printf -v quoted %q "${word#"$begun"}"
        [[ $word == *[=./] ]] || quoted+=" "
        COMPREPLY+=("$quoted")
    done < <("${COMP_WORDS[0]/#\~/$HOME}" completion line "$line" 2>/dev/null)
}
complete -o nospace -F _tactorch tactorch
